//! Where the learned surface is known to end: the demonstration's pictures see through places
//! just beyond it. What goes on there is another thing, however much it looks like this one.
//!
//! In: keyframes with the pose of each part, and surface (object frame at configuration 0, metres).
//! Out: edges. The surface of each is followed from a piece of surface in a direction of its tangent
//! plane for as long as the pictures show it, so that the edge is known to about half a centimetre.

use super::part_labels::PosedFrame;
use crate::math::rigid::orthonormal_basis;
use crate::object::appearance::{Edge, Surfel};
use crate::object::model::{Joint, ObjectModel};
use linkage_frames::RgbdFrame;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// How far beyond a piece of surface the place lies that must be seen through, metres.
const BEYOND_M: f64 = 0.04;
/// Distance from the surface from which all places must be seen through, too, metres: depth is
/// unreliable at edges.
const EDGE_MARGIN_M: f64 = 0.03;
/// The surface is followed by steps of this length, metres.
const STEP_M: f64 = 0.005;
/// Steps by which it is followed: pieces of surface farther from their edge are left out.
const STEPS: usize = 6;
/// Distance of an edge's `surface` from the end of the surface, metres: the last place that shows it is
/// half a step from the end on average, and [`Edge`] names the one before it, as depth is unreliable
/// at edges.
pub const INSET_M: f64 = 1.5 * STEP_M;
/// Directions in the tangent plane that are tried.
const DIRECTIONS: usize = 8;
/// Frames that must see through a place.
const LEAST_THROUGH: usize = 3;
/// Share of the frames in which something may be at a place beside the base: what moves.
const MAX_PASSING: f64 = 0.1;
/// Least cosine between a surface and the viewing ray of a picture that shows it.
const LEAST_COSINE: f64 = 0.3;

/// At most `per_part` edges of each part's surface, which comes in random order.
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

/// Pieces of surface looked at before it is asked whether there are edges enough.
const AT_ONCE: usize = 500;

/// A keyframe and the configuration of the joint that carries a part.
struct View<'p> {
    posed: &'p PosedFrame<'p>,
    configuration: f64,
}

impl<'p> View<'p> {
    /// `None` where the configuration is not known.
    fn of(posed: &'p PosedFrame, joint: Option<&Joint>) -> Option<Self> {
        let time = posed.frame.utime as f64 * 1e-6;
        let configuration = match joint {
            None => 0.0,
            Some(j) => j.configuration.iter().find(|c| (c[0] - time).abs() < 1e-4)?[1],
        };
        Some(Self { posed, configuration })
    }

    /// Whether nothing is at a place of a part; `None` where that is not known.
    fn sees_through(&self, part: u16, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<bool> {
        let camera_from_part = self.posed.camera_from_part[usize::from(part)].as_ref()?;
        is_empty(self.posed.frame, &(camera_from_part * place), &(camera_from_part * normal))
    }
}

/// Whether nothing is at a place where a surface of that normal might be, both in the camera
/// frame; `None` where something hides the place or it is not seen.
pub fn is_empty(frame: &RgbdFrame, place: &Point3<f64>, normal: &Vector3<f64>) -> Option<bool> {
    let cosine = normal.dot(&place.coords).abs() / place.coords.norm();
    if cosine < LEAST_COSINE {
        return None;
    }
    let pixel = frame.camera.project(place)?;
    let behind = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?) - place.z;
    let tolerance = frame.camera.depth_sensor.tolerance(place.z, cosine);
    match behind > 2.0 * tolerance {
        true => Some(true),
        false => (behind.abs() < tolerance).then_some(false),
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
        // Most surface goes on: that is told by the farthest place alone.
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

/// Most pictures that show a place show surface there.
fn is_surface(views: &[View], part: u16, place: &Point3<f64>, normal: &Vector3<f64>) -> bool {
    let seen = views.iter().filter_map(|v| v.sees_through(part, place, normal));
    let (through, all) =
        seen.fold((0, 0), |(t, all), is_through| (t + usize::from(is_through), all + 1));
    2 * through < all
}

/// Configurations between which a place is seen through, and never otherwise; `None` where it is
/// not. What is beside the base is there or not whatever the configuration.
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
