//! Frames of the recording, evenly spread over the motion, with the axes and the surface points of
//! the parts where they were learned to be in that frame: a film strip, or an animation.

use super::draw::{Canvas, part_colour};
use super::overlay;
use super::units::amount;
use linkage_driver::{ColorImage, RgbdFrame};
use linkage_skill::object::{Appearance, Joint, ObjectModel};
use linkage_skill::{Demonstration, Pose};

/// Time by which a configuration may be away from a frame, microseconds.
const AT_ONCE_US: f64 = 0.2e6;

/// A small picture.
pub struct StripFrame {
    pub picture: ColorImage,
    /// When it is, and how far each joint is.
    pub caption: String,
    /// How far the joints are together, as shares of their ranges from where they began.
    pub opened: f64,
}

/// At most `count` pictures that are `width` pixels wide.
pub fn film_strip(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
    count: usize,
    width: i32,
) -> anyhow::Result<Vec<StripFrame>> {
    let frames: Vec<(usize, &RgbdFrame)> = demonstration.keyframes.iter().collect();
    let model = &demonstration.model;
    let utimes: Vec<i64> = frames.iter().map(|(_, frame)| frame.utime).collect();
    let farthest = model.joints.iter().filter_map(|joint| farthest(joint, &utimes));
    let chosen = spread_over_motion(&way(model, &utimes), count);
    let mut farthest: Vec<usize> = farthest.collect();
    farthest.truncate(count.saturating_sub(1));
    let chosen = with_all(chosen, &farthest);
    let start = demonstration.frame_utimes.first().copied().unwrap_or(0);
    chosen
        .into_iter()
        .map(|k| {
            let (index, frame) = frames[k];
            let poses: Vec<Option<Pose>> =
                demonstration.camera_from_part.iter().map(|t| t.get(index).copied()?).collect();
            let mut canvas = Canvas::new(frame)?;
            if let Some(appearance) = appearance {
                overlay::surface(&mut canvas, frame, appearance, &poses)?;
            }
            axes(&mut canvas, model, &poses)?;
            canvas.shrink_to(width)?;
            Ok(StripFrame {
                picture: canvas.finish()?,
                caption: caption(model, frame.utime, start),
                opened: opened(model, frame.utime),
            })
        })
        .collect()
}

/// Draws each joint's axis where its carrier is.
pub fn axes(
    canvas: &mut Canvas,
    model: &ObjectModel,
    camera_from_part: &[Option<Pose>],
) -> anyhow::Result<()> {
    for joint in &model.joints {
        if let Some(camera_from_parent) = camera_from_part.get(joint.parent).copied().flatten() {
            let line = joint.geometry().transformed(&camera_from_parent);
            canvas.axis(&line, part_colour(joint.child))?;
        }
    }
    Ok(())
}

/// The configuration of a joint at a time, where it is known.
pub fn configuration_at(joint: &Joint, utime: i64) -> Option<f64> {
    let away = |c: &[f64; 2]| (c[0] * 1e6 - utime as f64).abs();
    let nearest = joint.configuration.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
    (away(nearest) <= AT_ONCE_US).then_some(nearest[1])
}

/// "2.4 s: joint1 34°, joint2 12 cm".
fn caption(model: &ObjectModel, utime: i64, start: i64) -> String {
    let seconds = (utime - start) as f64 * 1e-6;
    let joints: Vec<String> = model
        .joints
        .iter()
        .map(|j| match configuration_at(j, utime) {
            Some(q) => format!("{} {}", j.name, amount(j.kind, q)),
            None => format!("{} not known", j.name),
        })
        .collect();
    format!("{seconds:.1} s: {}", joints.join(", "))
}

/// How far all joints together are from where they began, as shares of their ranges.
fn opened(model: &ObjectModel, utime: i64) -> f64 {
    let share = |joint: &Joint| {
        let span = joint.range[1] - joint.range[0];
        let q = configuration_at(joint, utime)?;
        (span > 0.0).then(|| q.abs() / span)
    };
    model.joints.iter().filter_map(share).sum()
}

/// How far all joints together have moved up to each time, as shares of their ranges.
fn way(model: &ObjectModel, utimes: &[i64]) -> Vec<f64> {
    let mut last: Vec<Option<f64>> = vec![None; model.joints.len()];
    let mut way = 0.0;
    let mut up_to = |&utime: &i64| {
        for (joint, last) in model.joints.iter().zip(&mut last) {
            let span = joint.range[1] - joint.range[0];
            let Some(q) = configuration_at(joint, utime) else { continue };
            if let (Some(before), true) = (*last, span > 0.0) {
                way += (q - before).abs() / span;
            }
            *last = Some(q);
        }
        way
    };
    utimes.iter().map(&mut up_to).collect()
}

/// The frame in which a joint is farthest from where it began; none where it is never known.
fn farthest(joint: &Joint, utimes: &[i64]) -> Option<usize> {
    let known = utimes.iter().enumerate();
    let known = known.filter_map(|(k, utime)| Some((k, configuration_at(joint, *utime)?.abs())));
    known.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
}

/// The chosen places, of which the nearest ones but the first give way to those that must be among them.
fn with_all(mut chosen: Vec<usize>, wanted: &[usize]) -> Vec<usize> {
    for &k in wanted {
        if chosen.contains(&k) {
            continue;
        }
        let may_give_way = |i: &usize| !wanted.contains(&chosen[*i]);
        let nearest = (1..chosen.len()).filter(may_give_way).min_by_key(|&i| chosen[i].abs_diff(k));
        match nearest {
            Some(i) => chosen[i] = k,
            None => chosen.push(k),
        }
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// At most `count` places of a growing way, about evenly spread over it; nothing where it is empty.
fn spread_over_motion(way: &[f64], count: usize) -> Vec<usize> {
    let Some(&whole) = way.last() else { return Vec::new() };
    let mut chosen: Vec<usize> = (0..count)
        .map(|i| {
            let share = i as f64 / (count.max(2) - 1) as f64;
            if whole > 0.0 {
                way.partition_point(|w| *w < share * whole).min(way.len() - 1)
            } else {
                (share * (way.len() - 1) as f64).round() as usize
            }
        })
        .collect();
    chosen.dedup();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_over_the_motion_and_not_over_the_rest() {
        let mut way = vec![0.0; 50];
        way.extend((1..=10).map(|i| 0.1 * f64::from(i)));
        let chosen = spread_over_motion(&way, 6);
        assert_eq!(chosen[0], 0);
        assert!(chosen[1..].iter().all(|&k| k >= 50), "{chosen:?}");
        assert_eq!(chosen.len(), 6);
    }

    #[test]
    fn where_a_joint_is_farthest_is_among_them() {
        assert_eq!(with_all(vec![0, 10, 20, 30], &[14, 14]), [0, 14, 20, 30]);
        assert_eq!(with_all(vec![0, 10, 20, 30], &[20, 21]), [0, 10, 20, 21]);
        assert_eq!(with_all(vec![0, 10, 20, 30], &[1]), [0, 1, 20, 30], "the beginning stays");
        assert_eq!(with_all(vec![5], &[5, 7]), [5, 7]);
        assert_eq!(with_all(vec![], &[3]), [3]);
    }

    #[test]
    fn without_motion_they_are_spread_over_time() {
        assert_eq!(spread_over_motion(&[0.0; 11], 6), [0, 2, 4, 6, 8, 10]);
        assert_eq!(spread_over_motion(&[], 6), [0_usize; 0]);
        assert_eq!(spread_over_motion(&[0.0], 6), [0]);
    }
}
