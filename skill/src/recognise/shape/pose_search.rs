//! Search for poses of a part by its contour: some points of the model's contour are laid on some points of the
//! image's contour, and each pose is scored by the other points and by the surface.
//!
//! In: a scene with its contour, and an object's shape.
//! Out: hypotheses (camera frame, metres), best first.

use super::super::hypothesis::Hypothesis;
use super::super::kinematics::Articulated;
use super::super::render_cloud::CloudPoint;
use super::super::scene::Scene;
use super::super::verify::is_alike;
use super::contour::ContourPoint;
use super::contour_grid::ContourGrid;
use super::end_profile::pixel_of;
use super::ends::ends;
use super::object_shape::ObjectShape;
use super::part_alignment::aligned;
use crate::math::rigid::{Pose, matrix_pose};
use nalgebra::{IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;

/// Largest number of points of a part's contour that are laid on the contour of the image.
const MODEL_PLACES: usize = 40;
/// Largest number of points of the image's contour on which model points are laid.
const SEEN_PLACES: usize = 400;
/// Largest number of contour points, and of surfels, by which a pose is scored.
const JUDGED_BY: (usize, usize) = (60, 40);
/// Number of contour points that are tested first, and smallest number of them that the image must confirm.
const ASKED_FIRST: (usize, usize) = (10, 2);
/// Smallest number of contour points of a part that determine a pose.
const LEAST_CONTOUR: usize = 16;
/// Smallest number of contour points that the image must confirm.
const LEAST_HITS: usize = 10;
/// Largest number of poses of a part that are aligned.
const ALIGNED: usize = 24;
/// Largest number of poses of a part that are kept: a square board fits in four.
const KEPT: usize = 4;
/// Largest distance between poses that count as one: metres and radians.
const SAME: (f64, f64) = (0.05, 0.2);

/// Hypotheses of all parts by their contours, best first.
pub fn shape_hypotheses(
    scene: &Scene,
    seen: &ContourGrid,
    articulated: &Articulated,
    shape: &ObjectShape,
) -> Vec<Hypothesis> {
    let places = spread(&seen.points, SEEN_PLACES);
    let mut found: Vec<(f64, Hypothesis)> = Vec::new();
    for part in 0..articulated.parts {
        for (score, hits, camera_from_part) in part_poses(scene, seen, &places, shape, part) {
            let state = articulated.state_with(part, &camera_from_part, articulated.rest());
            found.push((score, Hypothesis { part, camera_from_part, state, support: hits }));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, hypothesis)| hypothesis).collect()
}

/// Poses of one part with their score and the number of confirmed contour points, best first.
fn part_poses(
    scene: &Scene,
    seen: &ContourGrid,
    places: &[ContourPoint],
    shape: &ObjectShape,
    part: usize,
) -> Vec<(f64, usize, Pose)> {
    let own: Vec<ContourPoint> = shape.contour.iter().filter(|c| c.part == part).copied().collect();
    if own.len() < LEAST_CONTOUR {
        return Vec::new();
    }
    let judge = Judge::new(scene, seen, &own, shape, part);
    let from = spread(&own, MODEL_PLACES);
    let mut tried: Vec<(f64, usize, Pose)> = places
        .par_iter()
        .flat_map_iter(|to| from.iter().filter_map(|c| judge.judged(laid_on(c, to)?)))
        .collect();
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let rough = distinct(tried, ALIGNED);
    let again =
        |(_, _, pose): (f64, usize, Pose)| judge.judged(aligned(scene, seen, shape, part, pose));
    let mut exact: Vec<(f64, usize, Pose)> = rough.into_par_iter().filter_map(again).collect();
    exact.sort_by(|a, b| b.0.total_cmp(&a.0));
    distinct(exact, KEPT)
}

/// Pose that lays a model point on a seen point; `None` if it is not finite.
fn laid_on(model: &ContourPoint, seen: &ContourPoint) -> Option<Pose> {
    let frame = |c: &ContourPoint| {
        Matrix3::from_columns(&[c.outward, c.normal, c.outward.cross(&c.normal)])
    };
    let rotation = Rotation3::from_matrix_unchecked(frame(seen) * frame(model).transpose());
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let shift = seen.point.coords - rotation * model.point.coords;
    shift
        .iter()
        .all(|x| x.is_finite())
        .then(|| Pose::from_parts(Translation3::from(shift), rotation))
}

/// The first poses that are not near an earlier one.
fn distinct(poses: Vec<(f64, usize, Pose)>, most: usize) -> Vec<(f64, usize, Pose)> {
    let mut kept: Vec<(f64, usize, Pose)> = Vec::new();
    for (score, hits, pose) in poses {
        let is_same = |(_, _, other): &(f64, usize, Pose)| {
            let apart = other.inverse() * pose;
            // The translation is also compared at the object: the origin of its frame may be far away.
            apart.rotation.angle() < SAME.1
                && (apart.translation.vector.norm() < SAME.0 || moved_little(other, &pose))
        };
        if !kept.iter().any(is_same) {
            kept.push((score, hits, pose));
            if kept.len() == most {
                break;
            }
        }
    }
    kept
}

/// True if the place 1 m along the z axis of the object frame hardly moves. The object frame is that of the first
/// camera: a small rotation of the object moves its origin, not the object.
fn moved_little(a: &Pose, b: &Pose) -> bool {
    let ahead = Point3::new(0.0, 0.0, 1.0);
    (a * ahead - b * ahead).norm() < SAME.0
}

/// Scores poses of one part.
struct Judge<'j> {
    scene: &'j Scene,
    seen: &'j ContourGrid,
    contour: Vec<ContourPoint>,
    surface: Vec<CloudPoint>,
}

impl<'j> Judge<'j> {
    fn new(
        scene: &'j Scene,
        seen: &'j ContourGrid,
        own: &[ContourPoint],
        shape: &ObjectShape,
        part: usize,
    ) -> Self {
        let surfels = &shape.clouds[part].surfels;
        let stride = surfels.len().div_ceil(JUDGED_BY.1).max(1);
        let surface = surfels.iter().step_by(stride).copied().collect();
        Self { scene, seen, contour: spread(own, JUDGED_BY.0), surface }
    }

    /// The pose with its score and the number of confirmed contour points; `None` if these are too few.
    fn judged(&self, pose: Pose) -> Option<(f64, usize, Pose)> {
        let matrix = matrix_pose(&pose);
        let (mut hits, mut misses) = (0, 0);
        for (i, c) in self.contour.iter().enumerate() {
            match ends(self.scene, self.seen, &matrix, c) {
                Some(true) => hits += 1,
                Some(false) => misses += 1,
                None => {}
            }
            if i + 1 == ASKED_FIRST.0 && hits < ASKED_FIRST.1 {
                return None;
            }
        }
        if hits < LEAST_HITS || misses > hits {
            return None;
        }
        let [alike, other, through] = self.surface(&matrix);
        let contour = hits as f64 - 0.5 * misses as f64;
        let surface = 0.5 * (alike as f64 - other as f64 - through as f64);
        (alike >= 2 * (other + through)).then_some((contour + surface, hits, pose))
    }

    /// Number of surfels that agree with the frame in depth and colour, that agree in depth alone, and that are seen
    /// through.
    fn surface(&self, pose: &IsometryMatrix3<f64>) -> [usize; 3] {
        let mut counts = [0; 3];
        let sensor = self.scene.frame.camera.depth_sensor;
        for s in &self.surface {
            let (point, normal) = (pose * s.point, pose * s.normal);
            let Some((u, v)) = pixel_of(self.scene, &point, &normal) else { continue };
            let Some(z) = self.scene.frame.depth.at(u, v).map(f64::from) else { continue };
            let cosine = -normal.dot(&point.coords) / point.coords.norm();
            let tolerance = 1.5 * sensor.tolerance(point.z, cosine);
            if z - point.z > 2.0 * tolerance {
                counts[2] += 1;
            } else if (z - point.z).abs() < tolerance {
                counts[usize::from(!is_alike(s.lab, self.scene.lab.at(u, v)))] += 1;
            }
        }
        counts
    }
}

/// At most `most` points, each as far as possible from those before it; starts with the first one (farthest-point
/// sampling).
fn spread(points: &[ContourPoint], most: usize) -> Vec<ContourPoint> {
    let Some(first) = points.first() else { return Vec::new() };
    let mut kept = vec![*first];
    // A point with another outward direction counts as far away: where edges meet, both are wanted.
    let apart = |a: &ContourPoint, b: &ContourPoint| {
        (a.point - b.point).norm() + 0.1 * (1.0 - a.outward.dot(&b.outward))
    };
    let mut nearest: Vec<f64> = points.iter().map(|p| apart(p, first)).collect();
    while kept.len() < most.min(points.len()) {
        let (next, distance) = nearest
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))
            .map_or((0, 0.0), |(i, d)| (i, *d));
        if distance <= 0.0 {
            break;
        }
        kept.push(points[next]);
        for (p, distance) in points.iter().zip(&mut nearest) {
            *distance = distance.min(apart(p, &points[next]));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::super::object_shape::Contours;
    use super::super::test_data::look_for_plain_slider;
    use super::*;
    use nalgebra::Vector3;

    /// How far the board of the slider was slid, metres.
    const SLID_M: f64 = 0.06;

    fn place(at: [f64; 3], normal: Vector3<f64>, outward: Vector3<f64>) -> ContourPoint {
        let point = at.into();
        ContourPoint { part: 0, point, normal, outward, side: 0, configurations: [0.0; 2] }
    }

    /// A place at this x, of a surface that faces the camera.
    fn facing(x: f64, outward: Vector3<f64>) -> ContourPoint {
        place([x, 0.0, 1.0], -Vector3::z(), outward)
    }

    fn turned(axis: Vector3<f64>, about: [f64; 3]) -> Pose {
        let about = Point3::from(about);
        let rotation = UnitQuaternion::from_scaled_axis(axis);
        Pose::from_parts(Translation3::from(about - rotation * about), rotation)
    }

    #[test]
    fn one_place_laid_on_another_tells_a_whole_pose() {
        let model = facing(0.2, Vector3::x());
        let truth = turned(Vector3::new(0.4, -0.3, 1.2), [0.1, 0.2, 0.9]);
        let seen = ContourPoint {
            point: truth * model.point,
            normal: truth * model.normal,
            outward: truth * model.outward,
            ..model
        };
        let apart = truth.inverse() * laid_on(&model, &seen).unwrap();
        assert!(apart.rotation.angle() < 1e-7 && apart.translation.vector.norm() < 1e-9);
    }

    #[test]
    fn a_place_that_is_no_number_is_laid_on_nothing() {
        let unknown = place([f64::NAN, 0.0, 1.0], -Vector3::z(), Vector3::x());
        assert!(laid_on(&facing(0.0, Vector3::x()), &unknown).is_none());
    }

    #[test]
    fn places_are_spread_as_far_as_may_be_and_both_are_kept_where_edges_meet() {
        let line: Vec<ContourPoint> =
            (0..=10).map(|i| facing(0.1 * f64::from(i), Vector3::y())).collect();
        let places = |kept: Vec<ContourPoint>| -> Vec<f64> {
            kept.iter().map(|c| (10.0 * c.point.x).round()).collect()
        };
        assert_eq!(places(spread(&line, 3)), [0.0, 10.0, 5.0]);
        assert_eq!(spread(&line, 100).len(), 11, "no more than there are");
        let corner = [facing(0.0, Vector3::x()), facing(0.0, Vector3::y())];
        assert_eq!(spread(&corner, 5).len(), 2);
        assert_eq!(spread(&[line[0], line[0]], 5).len(), 1, "one place twice");
        assert!(spread(&[], 5).is_empty());
    }

    #[test]
    fn of_poses_that_are_one_the_best_is_kept() {
        let at = |score: f64, pose| (score, 20, pose);
        let poses = vec![
            at(9.0, Pose::identity()),
            at(8.0, Pose::translation(0.03, 0.0, 0.0)),
            at(7.0, Pose::translation(0.3, 0.0, 0.0)),
            at(6.0, turned(Vector3::z() * 1.5, [0.0; 3])),
        ];
        let scores = |most| -> Vec<f64> {
            distinct(poses.clone(), most).into_iter().map(|(score, ..)| score).collect()
        };
        assert_eq!(scores(9), [9.0, 7.0, 6.0]);
        assert_eq!(scores(2), [9.0, 7.0]);
    }

    #[test]
    fn a_small_turn_of_a_thing_a_metre_away_is_no_other_pose() {
        let little = turned(Vector3::y() * 0.1, [0.0, 0.0, 1.0]);
        assert!(little.translation.vector.norm() > SAME.0, "its frame's origin goes far");
        assert_eq!(distinct(vec![(2.0, 20, Pose::identity()), (1.0, 20, little)], 9).len(), 1);
    }

    /// Looks at the slider's board as it is judged in the picture.
    fn judged<T>(look: impl FnOnce(&Judge) -> T) -> T {
        look_for_plain_slider(Some(0.2), SLID_M, |refiner, contours| {
            let own: Vec<ContourPoint> =
                contours.shape.contour.iter().filter(|c| c.part == 1).copied().collect();
            look(&Judge::new(refiner.scene, contours.seen, &own, contours.shape, 1))
        })
    }

    #[test]
    fn the_pose_in_which_a_board_is_seen_scores_more_than_one_beside_it() {
        judged(|judge| {
            let score = |x: f64| judge.judged(Pose::translation(x, 0.0, 0.0)).map(|(s, ..)| s);
            let in_place = score(SLID_M).unwrap();
            assert!(score(SLID_M + 0.08).is_none_or(|beside| beside < in_place - 10.0));
        });
    }

    #[test]
    fn a_pose_where_the_picture_shows_no_ends_is_refused() {
        judged(|judge| {
            for nowhere in [[0.5, 0.0, 0.0], [SLID_M, 0.0, 0.3], [SLID_M, 0.0, -0.3]] {
                let pose = Pose::translation(nowhere[0], nowhere[1], nowhere[2]);
                assert!(judge.judged(pose).is_none(), "{nowhere:?}");
            }
        });
    }

    #[test]
    fn surface_that_is_seen_through_is_told_from_what_agrees() {
        judged(|judge| {
            let of = |x: f64, z: f64| judge.surface(&matrix_pose(&Pose::translation(x, 0.0, z)));
            // At its border a surfel may see what is beside the board.
            let [alike, other, through] = of(SLID_M, 0.0);
            assert!(alike > 30 && other == 0 && through <= 4, "{alike} {other} {through}");
            let [alike, other, through] = of(SLID_M, -0.3);
            assert!(alike == 0 && other == 0 && through > 30, "{alike} {other} {through}");
            let [alike, other, through] = of(SLID_M, 0.3);
            assert!(alike == 0 && other == 0 && through <= 4, "hidden by what stands before it");
        });
    }

    #[test]
    fn a_plain_board_is_suggested_where_it_stands() {
        let (poses, suggested) = look_for_plain_slider(Some(0.2), SLID_M, |refiner, contours| {
            let Contours { shape, seen } = contours;
            let found = shape_hypotheses(refiner.scene, seen, refiner.articulated, shape);
            let poses: Vec<Pose> =
                found.iter().map(|h| refiner.articulated.poses(&h.state)[h.part]).collect();
            (poses, found)
        });
        let of_board = suggested.iter().filter(|h| h.part == 1);
        assert!((1..=KEPT).contains(&of_board.count()));
        let is_in_place = |h: &Hypothesis| {
            let off = Pose::translation(SLID_M, 0.0, 0.0).inverse() * h.camera_from_part;
            h.part == 1 && off.translation.vector.norm() < 0.015 && off.rotation.angle() < 0.03
        };
        assert!(suggested.iter().any(is_in_place), "{suggested:?}");
        for (hypothesis, pose) in suggested.iter().zip(poses) {
            let apart = hypothesis.camera_from_part.inverse() * pose;
            assert!(apart.translation.vector.norm() < 1e-9, "the state has the part there");
            assert!(hypothesis.support >= LEAST_HITS);
        }
    }

    #[test]
    fn nothing_is_suggested_before_a_wall_alone() {
        let found = look_for_plain_slider(None, SLID_M, |refiner, contours| {
            let Contours { shape, seen } = contours;
            shape_hypotheses(refiner.scene, seen, refiner.articulated, shape).len()
        });
        assert_eq!(found, 0);
    }
}
