//! In how many pictures something stood before a hinge, which makes its place less exact.
//!
//! In: keyframes with the poses of the parts, and the learned surface of the part that turns (object frame at
//! configuration 0, metres). Out: a sentence that says what to do.

use linkage_driver::RgbdFrame;
use linkage_skill::object::{Appearance, Joint, JointKind};
use linkage_skill::{Demonstration, Pose};
use nalgebra::{Point3, Vector3};

/// Places along the hinge that are looked at.
const PLACES: usize = 7;
/// Share of the part's surface beyond each end of the hinge: strays.
const BEYOND: f64 = 0.05;
/// What is this much nearer than the hinge hides it, metres, and as a share of its distance: a hinge lies inside of
/// doors and frames.
const NEARER_M: f64 = 0.06;
const NEARER_SHARE: f64 = 0.02;
/// What is this near to the part's surface is the part, metres: an open door stands before its hinge.
const OWN_M: f64 = 0.05;
/// A place that is free in less than this share of the keyframes is hidden by the thing itself.
const SOMETIMES_FREE: f64 = 0.2;
/// Share of the pictures from which it is told: more are kept while parts move.
const MUCH: f64 = 0.3;

/// A sentence where something stood before a hinge in many pictures.
pub fn hidden_hinge(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
    joint: &Joint,
) -> Option<String> {
    if joint.kind != JointKind::Revolute {
        return None;
    }
    let surface = surface(appearance?, joint.child);
    let places = places_along(joint, &surface)?;
    let pose =
        |part: usize, index: usize| demonstration.camera_from_part.get(part)?.get(index)?.as_ref();
    let looks = demonstration.keyframes.iter().filter_map(|(index, frame)| {
        let (hinge, own) = (pose(joint.parent, index)?, pose(joint.child, index)?);
        Some(places.iter().map(|place| is_hidden(frame, &(hinge * place), own, &surface)).collect())
    });
    let share = hidden_share(&looks.collect::<Vec<Vec<Option<bool>>>>());
    (share >= MUCH).then(|| {
        format!(
            "Something stood before its hinge in {:.0} % of the pictures that were kept: stand on the other side, so that \
             the camera sees the hinge.",
            100.0 * share
        )
    })
}

/// A part's learned surface.
fn surface(appearance: &Appearance, part: usize) -> Vec<Point3<f64>> {
    let own = appearance.surfels.iter().filter(|s| usize::from(s.part) == part);
    own.map(|s| Point3::from(s.point.map(f64::from))).collect()
}

/// Places on the hinge's line, as far as the part reaches along it.
fn places_along(joint: &Joint, surface: &[Point3<f64>]) -> Option<Vec<Point3<f64>>> {
    let (axis, origin) = (Vector3::from(joint.axis), Point3::from(joint.origin));
    let mut along: Vec<f64> = surface.iter().map(|p| (p - origin).dot(&axis)).collect();
    along.sort_by(f64::total_cmp);
    let last = along.len().checked_sub(1)?;
    let [low, high] = [BEYOND, 1.0 - BEYOND].map(|share| along[(share * last as f64) as usize]);
    let share = |i: usize| i as f64 / (PLACES - 1) as f64;
    Some((0..PLACES).map(|i| origin + axis * (low + share(i) * (high - low))).collect())
}

/// Whether something else than the part is before a place in a picture; `None` where that is not seen.
fn is_hidden(
    frame: &RgbdFrame,
    in_camera: &Point3<f64>,
    camera_from_part: &Pose,
    surface: &[Point3<f64>],
) -> Option<bool> {
    let pixel = frame.camera.project(in_camera)?;
    let z = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?);
    if z > in_camera.z - NEARER_M.max(NEARER_SHARE * in_camera.z) {
        return Some(false);
    }
    let seen =
        camera_from_part.inverse_transform_point(&frame.camera.back_project(pixel.x, pixel.y, z));
    let is_own = surface.iter().any(|p| (p - seen).norm() < OWN_M);
    Some(!is_own)
}

/// The share of keyframes in which the places are hidden that are free in others. `looks`: of each keyframe, whether
/// each place is hidden.
fn hidden_share(looks: &[Vec<Option<bool>>]) -> f64 {
    let places = looks.first().map_or(0, Vec::len);
    let shares = (0..places).filter_map(|place| {
        let seen: Vec<bool> = looks.iter().filter_map(|look| look[place]).collect();
        let hidden =
            seen.iter().filter(|hidden| **hidden).count() as f64 / seen.len().max(1) as f64;
        (!seen.is_empty() && 1.0 - hidden >= SOMETIMES_FREE).then_some(hidden)
    });
    let shares: Vec<f64> = shares.collect();
    shares.iter().sum::<f64>() / shares.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};
    use linkage_skill::object::JointGeometry;
    use std::sync::Arc;

    /// A picture of a wall 2 m away, with something at this depth in its left half.
    fn picture(left_m: f32) -> RgbdFrame {
        let camera = PinholeCamera {
            width: 64,
            height: 48,
            fx: 60.0,
            fy: 60.0,
            cx: 31.5,
            cy: 23.5,
            ..PinholeCamera::kinect()
        };
        let metres = (0..64 * 48).map(|i| if i % 64 < 32 { left_m } else { 2.0 }).collect();
        let depth = DepthImage::from_metres(64, 48, metres).unwrap();
        let color = ColorImage::new(64, 48, vec![90; 3 * 64 * 48]).unwrap();
        RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()
    }

    #[test]
    fn a_hinge_is_hidden_by_what_stands_before_it_but_not_by_its_own_door() {
        let [left, right] = [-0.5, 0.5].map(|x| Point3::new(x, 0.0, 2.0));
        let still = Pose::identity();
        let door = [Point3::new(-0.3, 0.0, 1.2)];
        let hidden = |depth_m: f32, place: &Point3<f64>, own: &[Point3<f64>]| {
            is_hidden(&picture(depth_m), place, &still, own)
        };
        assert_eq!(hidden(1.2, &left, &[]), Some(true));
        assert_eq!(hidden(1.2, &right, &[]), Some(false));
        assert_eq!(hidden(1.2, &left, &door), Some(false), "it is the door");
        assert_eq!(hidden(1.96, &left, &[]), Some(false), "it lies inside of the frame");
        assert_eq!(hidden(0.0, &left, &[]), None, "there is no depth");
        assert_eq!(hidden(1.2, &Point3::new(9.0, 0.0, 2.0), &[]), None, "it is out of the picture");
    }

    #[test]
    fn the_places_reach_along_the_hinge_as_far_as_the_part() {
        let line = JointGeometry::hinge(Vector3::y_axis(), Point3::new(0.3, 5.0, 2.0));
        let surface: Vec<Point3<f64>> =
            (0..=100).map(|i| Point3::new(0.0, 0.01 * f64::from(i), 2.0)).collect();
        let places = places_along(&Joint::of(&line), &surface).unwrap();
        let ends = [places[0], places[PLACES - 1]].map(|p| (p.y.clamp(0.0, 1.0) - p.y, p.x));
        assert_eq!(ends, [(0.0, 0.3); 2]);
        assert!((places[PLACES - 1].y - places[0].y).abs() > 0.85);
        assert!(places_along(&Joint::of(&line), &[]).is_none());
    }

    #[test]
    fn what_is_never_free_is_hidden_by_the_thing_itself_and_does_not_count() {
        let (free, hidden) = (Some(false), Some(true));
        assert!(hidden_share(&[]).abs() < 1e-9);
        let always = vec![vec![hidden, free]; 5];
        assert!(hidden_share(&always).abs() < 1e-9);
        let half = [vec![[hidden, free]; 5], vec![[free, free]; 5]].concat();
        let half: Vec<Vec<Option<bool>>> = half.iter().map(|look| look.to_vec()).collect();
        assert!((hidden_share(&half) - 0.25).abs() < 1e-9);
        let unseen = vec![vec![None], vec![hidden], vec![free]];
        assert!((hidden_share(&unseen) - 0.5).abs() < 1e-9);
    }
}
