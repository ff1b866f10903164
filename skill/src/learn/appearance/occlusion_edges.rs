//! Finds where the learned surface ends: the demonstration's images see through places just beyond it. A surface that
//! continues there is another object, however similar it is.
//!
//! The surface is followed from each surfel in several directions of its tangent plane for as long as the images show
//! it, so that the edge is known to about half a centimetre.
//!
//! In: keyframes with the pose of each part, and surfels (object frame at configuration 0, metres).
//! Out: edges, in the same frame, with the configurations at which the place beyond each is seen through.

use super::part_labels::PosedFrame;
use crate::math::rigid::orthonormal_basis;
use crate::object::appearance::{Edge, Surfel};
use crate::object::model::{Joint, ObjectModel};
use crate::object::surface_end::{STEP_M, is_empty};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Distance from an edge's `surface` to its `beyond`, which must be seen through, metres.
const BEYOND_M: f64 = 0.04;
/// Distance from an edge's `surface` to a nearer place that must be seen through as well, metres; still nearer, depth
/// is unreliable.
const EDGE_MARGIN_M: f64 = 0.03;
/// Most steps by which the surface is followed.
const STEPS: usize = 6;
/// Directions in the tangent plane that are tried.
const DIRECTIONS: usize = 8;
/// Fewest frames that must see through a place.
const LEAST_THROUGH: usize = 3;
/// Largest share of the frames in which a place beside the base may be occupied by something that moves.
const MAX_PASSING: f64 = 0.1;

/// At most `per_part` edges of each part. `surface` comes in random order, so that the edges are spread over it.
pub fn edges(
    posed: &[PosedFrame],
    surface: &[Surfel],
    model: &ObjectModel,
    per_part: usize,
) -> Vec<Edge> {
    let mut edges = Vec::new();
    for part in 0..model.parts.len() {
        let joint = model.joints.iter().find(|j| j.child == part);
        let views: Vec<View> = posed.iter().filter_map(|frame| View::of(frame, joint)).collect();
        let own: Vec<&Surfel> = surface.iter().filter(|s| usize::from(s.part) == part).collect();
        let mut found: Vec<Edge> = Vec::new();
        for some in own.chunks(AT_ONCE) {
            if found.len() < per_part {
                found.par_extend(some.par_iter().flat_map_iter(|s| edges_beside(s, &views)));
            }
        }
        edges.extend(found.into_iter().take(per_part));
    }
    edges
}

/// Surfels tested in parallel before the number of edges found is checked.
const AT_ONCE: usize = 500;

/// A keyframe with the configuration of the joint that carries a part.
struct View<'p> {
    posed: &'p PosedFrame<'p>,
    configuration: f64,
}

impl<'p> View<'p> {
    /// The view of a keyframe; `None` where the configuration is not known.
    fn of(posed: &'p PosedFrame, joint: Option<&Joint>) -> Option<Self> {
        let time = posed.frame.utime as f64 * 1e-6;
        let configuration = match joint {
            None => 0.0,
            Some(j) => j.configuration.iter().find(|c| (c[0] - time).abs() < 1e-4)?[1],
        };
        Some(Self { posed, configuration })
    }

    /// True if nothing is at a place of a part (object frame at configuration 0); `None` where that is not known.
    fn sees_through(&self, part: u16, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<bool> {
        let camera_from_part = self.posed.camera_from_part[usize::from(part)].as_ref()?;
        is_empty(self.posed.frame, &(camera_from_part * place), &(camera_from_part * normal))
    }
}

fn edges_beside(s: &Surfel, views: &[View]) -> Vec<Edge> {
    let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
    let (surface, normal) = (Point3::from(wide(s.point)), wide(s.normal));
    let (u, v) = orthonormal_basis(&normal);
    let directions = (0..DIRECTIONS).map(|i| TAU * i as f64 / DIRECTIONS as f64);
    let narrow = |place: Point3<f64>| place.coords.map(|x| x as f32).into();
    let edge = |angle: f64| {
        let towards = u * angle.cos() + v * angle.sin();
        let at = |distance: f64| surface + towards * distance;
        // Most surface continues; the farthest place alone rejects it quickly.
        free(views, s.part, &at(BEYOND_M + STEPS as f64 * STEP_M), &normal)?;
        let is_surface =
            |step: &usize| is_surface(views, s.part, &at(*step as f64 * STEP_M), &normal);
        let followed = (1..=STEPS).take_while(is_surface).count();
        let last = followed.saturating_sub(1) as f64 * STEP_M;
        let (low, high) = free(views, s.part, &at(last + BEYOND_M), &normal)?;
        let (nearer_low, nearer_high) = free(views, s.part, &at(last + EDGE_MARGIN_M), &normal)?;
        let (low, high) = (low.max(nearer_low), high.min(nearer_high));
        (low <= high).then(|| Edge {
            part: s.part,
            surface: narrow(at(last)),
            normal: s.normal,
            beyond: narrow(at(last + BEYOND_M)),
            configurations: [low as f32, high as f32],
        })
    };
    directions.filter_map(edge).collect()
}

/// True if most images that show a place show surface there.
fn is_surface(views: &[View], part: u16, place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
    let seen = views.iter().filter_map(|v| v.sees_through(part, place, normal));
    let (through, all) =
        seen.fold((0, 0), |(t, all), is_through| (t + usize::from(is_through), all + 1));
    2 * through < all
}

/// The longest range of configurations in which every image that shows a place sees through it; `None` if too few
/// images do. Beside the base the configuration does not matter, and the range is 0 to 0.
fn free(
    views: &[View],
    part: u16,
    place: &Point3<f64>,
    normal: &Vector3<f64>,
) -> Option<(f64, f64)> {
    let seen_at = |v: &View| Some((v.configuration, v.sees_through(part, place, normal)?));
    let mut seen: Vec<(f64, bool)> = views.iter().filter_map(seen_at).collect();
    if part == 0 {
        let through = seen.iter().filter(|t| t.1).count();
        let passing = (seen.len() - through) as f64 / seen.len().max(1) as f64;
        return (through >= LEAST_THROUGH && passing <= MAX_PASSING).then_some((0.0, 0.0));
    }
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    let runs = seen.chunk_by(|a, b| a.1 == b.1).filter(|run| run[0].1);
    let longest = runs.max_by_key(|run| run.len()).filter(|run| run.len() >= LEAST_THROUGH)?;
    Some((longest[0].0, longest[longest.len() - 1].0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::test_data::{board, seen};
    use linkage_frames::RgbdFrame;

    const HALF_M: f64 = 0.2;

    /// A drawer flush in a wall slides 30 cm towards the camera.
    fn pulled() -> Vec<(RgbdFrame, f64)> {
        let at = |i: i64| 0.02 * i as f64;
        (0..16).map(|i| (seen(i + 1, board(HALF_M, 1.5 - at(i), 1.5)), at(i))).collect()
    }

    fn edges_at(x: f64) -> Vec<Edge> {
        let frames = pulled();
        let posed: Vec<(PosedFrame, f64)> = frames
            .iter()
            .map(|(frame, slid)| {
                let front = Pose::translation(0.0, 0.0, -slid);
                (PosedFrame { frame, number: 0, camera_from_part: vec![None, Some(front)] }, *slid)
            })
            .collect();
        let views: Vec<View> =
            posed.iter().map(|(posed, q)| View { posed, configuration: *q }).collect();
        let (point, normal) = ([x as f32, 0.0, 1.5], [0.0, 0.0, -1.0]);
        edges_beside(&Surfel { part: 1, point, normal, lab: [50.0, 0.0, 0.0] }, &views)
    }

    #[test]
    fn a_drawer_is_known_to_end_once_it_stands_out() {
        let edges = edges_at(HALF_M - 0.01);
        let outwards = edges.iter().max_by(|a, b| a.beyond[0].total_cmp(&b.beyond[0])).unwrap();
        assert!(f64::from(outwards.beyond[0]) > HALF_M + 0.02);
        let [low, high] = outwards.configurations;
        assert!(low > 0.01 && low < 0.1 && high > 0.29, "{low} to {high}");
        assert!(edges.iter().all(|e| f64::from(e.beyond[0]) > HALF_M));
    }

    #[test]
    fn the_middle_of_a_drawer_is_no_edge() {
        assert!(edges_at(0.0).is_empty());
    }
}
