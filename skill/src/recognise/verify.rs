//! Verification: the surface that should be visible in a state is compared with the frame in depth, normal and
//! colour.
//!
//! In: a scene and a state (camera frame, metres and radians).
//! Out: a [`Verdict`].

use super::edge_test::test_edges;
use super::kinematics::{Articulated, State};
use super::patch_colour::PatchColours;
use super::render_cloud::{Cloud, DepthBuffer, Placed, visible};
use super::scene::Scene;
use super::verdict::Verdict;
use crate::math::robust::median;

/// Compares a state with the frame.
pub fn verify(scene: &Scene, articulated: &Articulated, cloud: &Cloud, state: &State) -> Verdict {
    let mut verdict = Verdict::nothing_yet(articulated.parts);
    let mut colours = vec![PatchColours::default(); cloud.part_of_patch.len()];
    let visible = visible(scene, cloud, &articulated.poses(state));
    if !cloud.edges.is_empty() {
        let buffer = DepthBuffer::of(&visible);
        let all = test_edges(scene, articulated, &cloud.edges, state, &buffer);
        verdict.parts.iter_mut().zip(all).for_each(|(part, edges)| part.edges = edges);
    }
    for surfel in visible {
        compare(scene, cloud, &surfel, &mut verdict, &mut colours);
    }
    // Occluded surfels do not count against the state, up to half of all.
    let half = verdict.judged / 2;
    verdict.judged -= verdict.hidden.min(half);
    verdict.set_correlations(cloud, &colours);
    verdict
}

/// Smallest cosine between the normal of a surfel and the seen normal for them to agree.
const SAME_NORMAL: f64 = 0.87;
/// Smallest cosine between the normal of a surfel and the seen normal for the colours to be compared.
const COMPARABLE_NORMAL: f64 = 0.7;

/// Counts one surfel as seen through, occluded or in agreement.
fn compare(
    scene: &Scene,
    cloud: &Cloud,
    surfel: &Placed,
    verdict: &mut Verdict,
    colours: &mut [PatchColours],
) {
    let (u, v) = surfel.pixel;
    let Some(z) = scene.frame.depth.at(u, v) else { return };
    let tolerance = scene.frame.camera.depth_sensor.tolerance(surfel.point.z, surfel.cosine);
    let behind = f64::from(z) - surfel.point.z;
    if behind > 2.0 * tolerance {
        if !is_beside(scene, surfel, tolerance) {
            verdict.judged += 1;
            verdict.through += 1;
            verdict.parts[surfel.part].through += 1;
        }
        return;
    }
    verdict.judged += 1;
    if behind < -tolerance {
        verdict.hidden += 1;
    } else if behind < tolerance {
        verdict.agree += 1;
        let cosine = scene.surface(u, v).map_or(0.0, |s| s.normal.dot(&surfel.normal));
        if cosine > SAME_NORMAL {
            verdict.agree_normal += 1;
            let part = &mut verdict.parts[surfel.part];
            part.agree += 1;
            part.alike +=
                usize::from(is_alike(cloud.surfels[surfel.index].lab, scene.lab.at(u, v)));
        }
        if cosine > COMPARABLE_NORMAL {
            let learned = cloud.surfels[surfel.index].lab;
            colours[cloud.patches[surfel.index]].add(learned, scene.lab.at(u, v));
        }
    }
}

/// Largest difference of chroma (a* and b*) and of lightness (L*) of one surface in two lights.
const ALIKE: (f32, f32) = (12.0, 30.0);

/// True if two L*a*b* colours may be those of one surface in two lights.
pub fn is_alike(learned: [f32; 3], seen: [f32; 3]) -> bool {
    let colour = (learned[1] - seen[1]).hypot(learned[2] - seen[2]);
    colour < ALIKE.0 && (learned[0] - seen[0]).abs() < ALIKE.1
}

/// Largest common shift of chroma (each of a* and b*) and of lightness (L*) by another light.
const OTHER_LIGHT: (f32, f32) = (12.0, 30.0);

/// Share of the surface in its place, 0 to 1, that has the learned colour after one common shift: all of it may be
/// yellower or darker than learned, but by the same amount.
pub fn likeness_in_any_light(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
) -> f64 {
    let in_place = |p: &Placed| {
        let (u, v) = p.pixel;
        let z = f64::from(scene.frame.depth.at(u, v)?);
        let tolerance = scene.frame.camera.depth_sensor.tolerance(p.point.z, p.cosine);
        let is_there = (z - p.point.z).abs() < tolerance
            && scene.surface(u, v).is_some_and(|s| s.normal.dot(&p.normal) > SAME_NORMAL);
        is_there.then(|| (cloud.surfels[p.index].lab, scene.lab.at(u, v)))
    };
    let colours: Vec<([f32; 3], [f32; 3])> =
        visible(scene, cloud, &articulated.poses(state)).iter().filter_map(in_place).collect();
    let shift = [OTHER_LIGHT.1, OTHER_LIGHT.0, OTHER_LIGHT.0];
    let shift: [f32; 3] = std::array::from_fn(|k| {
        let mut shifts: Vec<f64> =
            colours.iter().map(|(learned, seen)| f64::from(seen[k] - learned[k])).collect();
        let middle = median(&mut shifts).unwrap_or(0.0) as f32;
        middle.clamp(-shift[k], shift[k])
    });
    let alike = |(learned, seen): &&([f32; 3], [f32; 3])| {
        is_alike(std::array::from_fn(|k| learned[k] + shift[k]), *seen)
    };
    colours.iter().filter(alike).count() as f64 / colours.len().max(1) as f64
}

/// Largest distance of a seen edge from its place in a right state, metres: poses from features are no more precise.
const BESIDE_M: f64 = 0.005;

/// True if a reading right beside the pixel of a surfel has the depth of the surfel.
fn is_beside(scene: &Scene, p: &Placed, tolerance: f64) -> bool {
    let reach = (BESIDE_M * scene.frame.camera.fx / p.point.z).ceil() as isize;
    let (u, v) = p.pixel;
    let is_there = |du: isize, dv: isize| {
        let pixel = u.checked_add_signed(du).zip(v.checked_add_signed(dv));
        let z = pixel.and_then(|(u, v)| scene.frame.depth.at(u, v));
        z.is_some_and(|z| (f64::from(z) - p.point.z).abs() < tolerance)
    };
    let steps = [-reach, 0, reach];
    steps.iter().any(|&dv| steps.iter().any(|&du| is_there(du, dv)))
}

/// Compares the colours of a state with a frame without depth. Occluders are not detected, so they count against the
/// state.
pub fn verify_appearance(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
) -> Verdict {
    let mut verdict = Verdict::nothing_yet(articulated.parts);
    let mut colours = vec![PatchColours::default(); cloud.part_of_patch.len()];
    for p in visible(scene, cloud, &articulated.poses(state)) {
        let learned = cloud.surfels[p.index].lab;
        colours[cloud.patches[p.index]].add(learned, scene.lab.at(p.pixel.0, p.pixel.1));
    }
    verdict.set_correlations(cloud, &colours);
    verdict
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rigid::Pose;
    use crate::recognise::render_cloud::CloudPoint;
    use crate::test_data::{board, seen};
    use nalgebra::{Point3, Vector3};

    /// Surfels of a board 40 cm wide that are seen through where one stands this far to its right.
    fn seen_through_beside(shift: f64) -> usize {
        let side = || (-20..=20).map(|i| 0.01 * f64::from(i));
        let surfel = |(x, y)| CloudPoint {
            part: 0,
            point: Point3::new(x, y, 1.5),
            normal: -Vector3::z(),
            lab: [50.0, 0.0, 0.0],
        };
        let cloud =
            Cloud::of(side().flat_map(|x| side().map(move |y| (x, y))).map(surfel).collect());
        let seen_board = board(0.203, 1.5, 2.5);
        let scene = Scene::plain(&seen(1, |x, y| seen_board(x - shift / 1.5, y))).unwrap();
        let alone = Articulated { parts: 1, joints: Vec::new() };
        let state = State { camera_from_object: Pose::identity(), q: Vec::new() };
        verify(&scene, &alone, &cloud, &state).through
    }

    #[test]
    fn an_edge_a_little_beside_its_place_is_not_seen_through() {
        assert_eq!(seen_through_beside(0.006), 0);
        assert!(seen_through_beside(0.02) >= 41);
    }
}
