//! Follows a surface along a joint through all keyframes, by depth alone.
//!
//! All keyframes are solved together as the path of most agreement: a single keyframe may agree with several
//! configurations, where a hand covers the part or another part looks the same, but a part moves on from where it
//! was.
//!
//! In: points of the surface (base frame, at configuration 0 of the joint), the joint's line, a range of
//! configurations (radians or metres), and the keyframes.
//! Out: one configuration per keyframe, and how well the depth images agree with it.
//! From: dynamic programming (Viterbi), then point-to-plane alignment by Gauss-Newton.

use crate::learn::best_path::best_path;
use crate::learn::free_space::{FreeSpaceCounts, count_free_space, thinned};
use crate::learn::recording::Recording;
use crate::math::rigid::Pose;
use crate::object::joint_geometry::JointGeometry;
use linkage_frames::RgbdFrame;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Number of configurations that are tried.
const STEPS: usize = 129;
/// Most points of a surface that are tested in the images.
pub const MAX_POINTS: usize = 150;
/// Smallest share of a surface's points that a keyframe must find to show the surface.
const LEAST_SHOWN: f64 = 0.3;
/// Smallest share of a surface's points that a keyframe must find to determine the configuration by itself.
const CERTAINLY_FOUND: f64 = 0.4;
/// Largest share of a surface's points that a keyframe which determines the configuration by itself may see through.
/// Of doors seen nearly edge-on, 7 to 9 % were seen through where they were followed to within 0.03 rad, and 20 % and
/// more where they were not.
const CERTAINLY_THROUGH: f64 = 0.1;
/// An end of a recording is one keyframe in this many: the first or the last tenth.
const PARTS_PER_END: usize = 10;
/// Fewest keyframes of an end of a recording.
const MIN_END: usize = 3;
/// Gauss-Newton steps from the best configuration tried.
const ALIGNMENTS: usize = 3;
/// Factor by which alignment may lengthen the largest step of a path.
const ALIGNED: f64 = 1.1;
/// Smallest share of the bound on a step at which the bound counts as reached: the grid of configurations and the
/// alignment make such a step a little smaller.
const AT_BOUND: f64 = 0.9;
/// Largest residual of the surface itself, metres; a farther reading belongs to another surface.
const MAX_RESIDUAL_M: f64 = 0.04;
/// Largest cosine between a plate's normal and the direction to the camera at which the plate is seen edge-on and
/// shows neither face.
pub const EDGE_ON: f64 = 0.2;
/// Cost of a metre of travel between two keyframes, as a share of the agreement of all points. A path that jumps to
/// and fro must gain more agreement than that.
const COST_PER_METRE: f64 = 2.0;

/// A flat surface in the base frame, at configuration 0. A plate has two faces, some centimetres apart; a lid shows
/// its other face when it has turned over.
#[derive(Debug, Clone)]
pub struct Surface {
    /// Points of the known face.
    pub points: Vec<Point3<f64>>,
    /// Unit normal of the known face.
    pub normal: Vector3<f64>,
    /// Points of the other face, whose normal is opposite; empty if that face was not seen.
    pub back: Vec<Point3<f64>>,
}

impl Surface {
    /// The surface with at most `most` points of each face, evenly spread, because [`follow`] tests every point in
    /// every keyframe.
    pub fn thinned(&self, most: usize) -> Self {
        let Self { points, normal, back } = self;
        Self { points: thinned(points, most), normal: *normal, back: thinned(back, most) }
    }

    /// The points of the face that is turned to the camera; none of a plate seen edge-on; all points if only one face
    /// is known.
    fn in_sight(&self, camera_from_part: &Pose) -> &[Point3<f64>] {
        let (Some(first), Some(_)) = (self.points.first(), self.back.first()) else {
            return &self.points;
        };
        match self.cosine_at(first, camera_from_part) {
            c if c > EDGE_ON => &self.points,
            c if c < -EDGE_ON => &self.back,
            _ => &[],
        }
    }

    /// True if the known face is turned to the camera, or both faces are known. A part that has turned over shows its
    /// other face, which is offset by the thickness.
    pub fn is_turned_to_camera(&self, camera_from_part: &Pose) -> bool {
        !self.back.is_empty()
            || self.points.first().is_some_and(|p| self.cosine_at(p, camera_from_part) > EDGE_ON)
    }

    /// Cosine of the angle between the normal and the direction from a point to the camera.
    fn cosine_at(&self, place: &Point3<f64>, camera_from_part: &Pose) -> f64 {
        let to_camera = -(camera_from_part * place).coords;
        (camera_from_part * self.normal).dot(&to_camera) / to_camera.norm()
    }
}

/// Configuration of a surface in one keyframe, with the agreement of the depth image.
#[derive(Debug, Clone, Copy)]
pub struct Placement {
    /// Frame number.
    pub frame: usize,
    /// Configuration, radians or metres.
    pub q: f64,
    /// Points found and seen through at the configuration.
    found: FreeSpaceCounts,
    /// Points found and seen through half the range aside, on the side that is seen through more.
    aside: FreeSpaceCounts,
    /// Number of points of the face that is turned to the camera.
    of: usize,
}

/// A surface that was followed along a joint.
#[derive(Debug, Clone)]
pub struct Following {
    /// One placement a keyframe, in time order.
    placements: Vec<Placement>,
}

impl Following {
    /// Share of the visible points that keyframes see through at the followed configurations.
    pub fn free_space_violation(&self) -> f64 {
        total(self.placements.iter().map(|p| p.found)).share_through()
    }

    /// Share of the visible points that would be seen through if the surface were half its range aside. If it is
    /// large, the images discriminate where the surface is.
    pub fn discriminability(&self) -> f64 {
        total(self.placements.iter().map(|p| p.aside)).share_through()
    }

    /// The placements in keyframes that show the surface.
    pub fn shown(&self) -> impl Iterator<Item = &Placement> {
        self.placements.iter().filter(|p| self.is_shown(p))
    }

    /// The placements in keyframes that find enough of the surface and see through little of it, so that the
    /// configuration is certain without a plane.
    pub fn certain(&self) -> impl Iterator<Item = &Placement> {
        self.placements.iter().filter(move |p| {
            let of = p.of.max(1) as f64;
            p.found.agrees as f64 >= CERTAINLY_FOUND * of
                && p.found.through as f64 <= CERTAINLY_THROUGH * of
        })
    }

    /// Number of keyframes over which the surface was followed.
    pub fn keyframes(&self) -> usize {
        self.placements.len()
    }

    /// Takes the configurations in some frames, radians, in which the surface shows its edge: they count neither for
    /// nor against it.
    pub fn set_edge_on(&mut self, configurations: &[(usize, f64)]) {
        for &(frame, q) in configurations {
            if let Ok(i) = self.placements.binary_search_by_key(&frame, |p| p.frame) {
                let counts = FreeSpaceCounts::default();
                self.placements[i] = Placement { frame, q, found: counts, aside: counts, of: 0 };
            }
        }
    }

    /// Share of the keyframes that show the surface, among those that do not see it edge-on.
    pub fn shown_ratio(&self) -> f64 {
        let may_show = self.placements.iter().filter(|p| p.of > 0).count();
        self.shown().count() as f64 / may_show.max(1) as f64
    }

    /// True if at least half of the keyframes at each end of the recording show the surface, not counting those that
    /// see it edge-on: parts stay, hands come and leave.
    pub fn is_there_throughout(&self) -> bool {
        let n =
            self.placements.len().div_ceil(PARTS_PER_END).max(MIN_END).min(self.placements.len());
        let (first, last) = (&self.placements[..n], &self.placements[self.placements.len() - n..]);
        [first, last].iter().all(|end| {
            let may_show = end.iter().filter(|p| p.of > 0).count();
            2 * end.iter().filter(|p| self.is_shown(p)).count() >= may_show
        })
    }

    /// Largest change of the configuration between two consecutive keyframes that show the surface, per keyframe from
    /// the one to the other; radians or metres.
    pub fn largest_step(&self) -> f64 {
        let all = self.placements.iter().enumerate();
        let shown: Vec<(usize, f64)> =
            all.filter(|(_, p)| self.is_shown(p)).map(|(i, p)| (i, p.q)).collect();
        let step = |w: &[(usize, f64)]| (w[1].1 - w[0].1).abs() / (w[1].0 - w[0].0) as f64;
        shown.windows(2).map(step).fold(0.0, f64::max)
    }

    /// True if the surface, between keyframes that show it, moves no farther than `max_steps` allow: the largest
    /// motion from each keyframe to the next, radians or metres.
    pub fn keeps_within(&self, max_steps: &[f64]) -> bool {
        let all = self.placements.iter().enumerate();
        let shown: Vec<(usize, f64)> =
            all.filter(|(_, p)| self.is_shown(p)).map(|(i, p)| (i, p.q)).collect();
        shown.windows(2).all(|w| {
            let between = max_steps.get(w[0].0..w[1].0).unwrap_or_default();
            (w[1].1 - w[0].1).abs() <= ALIGNED * between.iter().sum::<f64>()
        })
    }

    /// Largest number of consecutive steps in one direction that are as large as `max_steps` allow. A bounded path
    /// makes such steps where it cannot jump.
    pub fn longest_run_at(&self, max_steps: &[f64]) -> usize {
        let (mut longest, mut run, mut direction) = (0, 0, 0.0);
        for (w, max) in self.placements.windows(2).zip(max_steps) {
            let step = w[1].q - w[0].q;
            let is_at_bound = step.abs() >= AT_BOUND * max;
            let goes_on = is_at_bound && run > 0 && step.signum() == direction;
            run = if goes_on { run + 1 } else { usize::from(is_at_bound) };
            direction = step.signum();
            longest = longest.max(run);
        }
        longest
    }

    /// True if the configuration stays within `still`, radians or metres, for this many consecutive keyframes.
    /// Objects rest before and after they are moved; people do not.
    pub fn rests(&self, keyframes: usize, still: f64) -> bool {
        self.placements.windows(keyframes).any(|w| {
            let [low, high] = least_and_greatest(w.iter());
            high - low < still
        })
    }

    /// Smallest and largest configuration in keyframes that show the surface; an empty range if there are none.
    pub fn range(&self) -> [f64; 2] {
        least_and_greatest(self.shown())
    }

    /// The configuration in a keyframe, given by its frame number.
    pub fn at(&self, frame: usize) -> Option<f64> {
        let i = self.placements.binary_search_by_key(&frame, |p| p.frame).ok()?;
        Some(self.placements[i].q)
    }

    /// Shares of the surface's visible points, 0 to 1, that are seen through at the lower end of the range while it is
    /// at the upper end, and at the upper end while it is at the lower one; 0 where few points are visible. `at_end`:
    /// share of the range at an end.
    pub fn seen_through_at_other_end(
        &self,
        surface: &Surface,
        geometry: &JointGeometry,
        at_end: f64,
        recording: &Recording,
    ) -> [f64; 2] {
        let [low, high] = self.range();
        let apart = at_end * (high - low);
        // One placement a keyframe.
        let both = || self.placements.iter().zip(recording.keyframes.iter());
        let seen_through = |q: f64| {
            let is_elsewhere =
                |p: &Placement| self.is_shown(p) && (p.q - q).abs() > high - low - apart;
            let elsewhere = both().filter(|(p, _)| is_elsewhere(p)).map(|(_, keyframe)| keyframe);
            let counts = elsewhere.map(|(frame, picture)| {
                let camera_from_base = recording.ego_motion.camera_from_base[frame];
                let camera_from_part = camera_from_base * geometry.motion(q);
                let points = surface.in_sight(&camera_from_part);
                count_free_space(picture, points, &camera_from_part)
            });
            let all = total(counts);
            let is_told = all.count() as f64 >= LEAST_SHOWN * surface.points.len() as f64;
            if is_told { all.share_through() } else { 0.0 }
        };
        [low, high].map(seen_through)
    }

    /// True if a keyframe finds enough of the surface and sees through less of it.
    fn is_shown(&self, placement: &Placement) -> bool {
        let found = placement.found;
        found.agrees as f64 >= LEAST_SHOWN * placement.of as f64 && found.margin() > 0
    }
}

fn least_and_greatest<'p>(placements: impl Iterator<Item = &'p Placement>) -> [f64; 2] {
    placements
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p.q), high.max(p.q)])
}

fn total(counts: impl Iterator<Item = FreeSpaceCounts>) -> FreeSpaceCounts {
    counts.fold(FreeSpaceCounts::default(), |mut all, one| {
        all.add(one);
        all
    })
}

/// Range in which a surface is searched for, and the bound on its motion.
#[derive(Debug, Clone, Copy, Default)]
pub struct Search<'s> {
    /// Range of configurations, radians or metres.
    pub range: [f64; 2],
    /// Largest motion from each keyframe to the next, radians or metres; unbounded beyond the end of the list.
    pub max_steps: &'s [f64],
    /// Configurations that are known in some frames to within `guided_to`: by frame number, radians or metres.
    pub guides: &'s [(usize, f64)],
    /// Largest distance from a known configuration, radians or metres.
    pub guided_to: f64,
}

impl Search<'_> {
    /// True if a configuration in a frame does not contradict what is known of that frame.
    fn allows(&self, frame: usize, q: f64) -> bool {
        let known = self.guides.iter().find(|(guided, _)| *guided == frame);
        known.is_none_or(|(_, known)| (q - known).abs() < self.guided_to)
    }
}

/// Agreement of a configuration that is known to be wrong, in points.
const FORBIDDEN: f64 = -1e6;

/// Follows a surface over all keyframes. `reach` is the surface's distance from a hinge's line, metres; 1 for a
/// slide.
pub fn follow(
    surface: &Surface,
    geometry: &JointGeometry,
    reach: f64,
    search: &Search,
    recording: &Recording,
) -> Following {
    let Recording { ego_motion: base, keyframes, .. } = recording;
    let pictures: Vec<(usize, &RgbdFrame)> = keyframes.iter().collect();
    let [first, last] = search.range;
    let step = (last - first) / (STEPS - 1) as f64;
    let probe = |frame: usize, picture: &RgbdFrame, q: f64| {
        let camera_from_part = base.camera_from_base[frame] * geometry.motion(q);
        count_free_space(picture, surface.in_sight(&camera_from_part), &camera_from_part)
    };
    let gain = |frame: usize, picture: &RgbdFrame, i: usize| {
        let q = first + step * i as f64;
        if search.allows(frame, q) { probe(frame, picture, q).margin() as f64 } else { FORBIDDEN }
    };
    let table: Vec<Vec<f64>> = pictures
        .par_iter()
        .map(|&(frame, picture)| (0..STEPS).map(|i| gain(frame, picture, i)).collect())
        .collect();
    let cost_of_a_step = COST_PER_METRE * surface.points.len() as f64 * step * reach;
    let max_columns: Vec<usize> =
        search.max_steps.iter().map(|max| (max / step).ceil() as usize).collect();
    let path = best_path(&table, cost_of_a_step, &max_columns);
    let indices = || path.iter().copied();
    let (least, most) = (indices().min().unwrap_or(0), indices().max().unwrap_or(0));
    let aside = 0.5 * step * (most - least) as f64;
    let placements = pictures
        .par_iter()
        .zip(&path)
        .map(|(&(frame, picture), &i)| {
            let camera_from_base = base.camera_from_base[frame];
            let q = first + step * i as f64;
            let q = aligned(surface, geometry, q, picture, &camera_from_base);
            let [low, high] = [q - aside, q + aside].map(|q| probe(frame, picture, q));
            let aside = if high.through > low.through { high } else { low };
            let of = surface.in_sight(&(camera_from_base * geometry.motion(q))).len();
            Placement { frame, q, found: probe(frame, picture, q), aside, of }
        })
        .collect();
    Following { placements }
}

/// The configuration near `q` at which the surface agrees best with the depth image (least squares in one unknown).
fn aligned(
    surface: &Surface,
    geometry: &JointGeometry,
    mut q: f64,
    picture: &RgbdFrame,
    camera_from_base: &Pose,
) -> f64 {
    for _ in 0..ALIGNMENTS {
        let motion = geometry.motion(q);
        let (mut right, mut left) = (0.0, 0.0);
        for r in residuals(surface, 0.0, &motion, picture, camera_from_base) {
            let slope = r.normal.dot(&geometry.velocity(&(motion * r.point)));
            right += slope * r.distance;
            left += slope * slope;
        }
        if left < 1e-9 {
            break;
        }
        q += right / left;
    }
    q
}

/// Distance between the surface, moved to a configuration, and a depth reading.
pub struct Residual {
    /// Point of the surface, at configuration 0.
    pub point: Point3<f64>,
    /// The surface's normal after the motion, base frame.
    pub normal: Vector3<f64>,
    /// Distance from the moved point to the reading along the normal, metres.
    pub distance: f64,
}

/// Point-to-plane residuals of a surface, without those too large to be its own. `behind`: how far behind its points
/// the surface is seen, metres; the part's thickness if an image shows the other face, else 0.
pub fn residuals<'s>(
    surface: &'s Surface,
    behind: f64,
    motion: &Pose,
    picture: &'s RgbdFrame,
    camera_from_base: &Pose,
) -> impl Iterator<Item = Residual> + 's {
    let (camera_from_part, normal) = (camera_from_base * motion, motion * surface.normal);
    let in_camera = camera_from_base * normal;
    surface.in_sight(&camera_from_part).iter().filter_map(move |&point| {
        let place = camera_from_part * point;
        let pixel = picture.camera.project(&place)?;
        if !picture.camera.sees(&pixel, 3.0) {
            return None;
        }
        let z = picture.depth.at_nearest(pixel.x, pixel.y)?;
        let measured = picture.camera.back_project(pixel.x, pixel.y, f64::from(z));
        let distance = in_camera.dot(&(measured - place)) + behind;
        (distance.abs() < MAX_RESIDUAL_M).then_some(Residual { point, normal, distance })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::math::rigid::Pose;
    use crate::math::rigid::rotation_about;
    use crate::test_data::seen;
    use nalgebra::{UnitVector3, Vector3};

    /// A plate that moves to the camera by `q` metres, before a wall 3 m away.
    fn plate_at(q: f64) -> RgbdFrame {
        seen(0, |x, y| if x.abs() < 0.2 && y.abs() < 0.15 { 2.0 - q } else { 3.0 })
    }

    fn drawer() -> (Surface, JointGeometry) {
        let axis = UnitVector3::new_normalize(-Vector3::z());
        let geometry = JointGeometry::slide(axis, Point3::new(0.0, 0.0, 2.0));
        let points = (0..100)
            .map(|i| {
                let (x, y) = (f64::from(i % 10) - 4.5, f64::from(i / 10) - 4.5);
                Point3::new(0.07 * x, 0.05 * y, 2.0)
            })
            .collect();
        (Surface { points, normal: -Vector3::z(), back: Vec::new() }, geometry)
    }

    #[test]
    fn a_part_that_has_turned_over_shows_its_other_face_behind_the_known_one() {
        let (surface, _) = drawer();
        assert!(surface.is_turned_to_camera(&Pose::identity()));
        let axis = UnitVector3::new_normalize(Vector3::y());
        let over = rotation_about(&Point3::new(0.0, 0.0, 2.0), &axis, std::f64::consts::PI);
        assert!(!surface.is_turned_to_camera(&over));
        let plate = Surface { back: surface.points.clone(), ..surface.clone() };
        assert!(plate.is_turned_to_camera(&over), "both faces are known");
        // When turned over, the 3 cm plate shows its other face that much nearer to the camera.
        let picture = plate_at(0.03);
        let mut found = residuals(&surface, 0.03, &over, &picture, &Pose::identity()).peekable();
        assert!(found.peek().is_some());
        assert!(found.all(|r| r.distance.abs() < 1e-3));
    }

    #[test]
    fn a_keyframe_is_certain_that_sees_through_little_of_what_it_shows() {
        let placed = |agrees: usize, through: usize| {
            let found = FreeSpaceCounts { through, agrees };
            Placement { frame: 0, q: 0.0, found, aside: FreeSpaceCounts::default(), of: 100 }
        };
        let is_certain = |agrees: usize, through: usize| {
            let placements = vec![placed(agrees, through)];
            Following { placements }.certain().count() == 1
        };
        assert!(is_certain(60, 0) && is_certain(60, 8), "a door nearly seen from its edge");
        assert!(!is_certain(60, 20) && !is_certain(30, 0));
    }

    #[test]
    fn what_shows_its_edge_counts_neither_for_nor_against() {
        let placed = |agrees: usize| Placement {
            frame: 0,
            q: 0.0,
            found: FreeSpaceCounts { through: 100 - agrees, agrees },
            aside: FreeSpaceCounts::default(),
            of: 100,
        };
        let placements: Vec<Placement> = (0..12)
            .map(|frame| Placement { frame, ..placed(if frame < 4 { 95 } else { 5 }) })
            .collect();
        let mut following = Following { placements };
        assert!(!following.is_there_throughout() && following.shown_ratio() < 0.4);
        let edge_on: Vec<(usize, f64)> = (4..12).map(|frame| (frame, 1.5)).collect();
        following.set_edge_on(&edge_on);
        assert!(following.is_there_throughout() && following.shown_ratio() >= 1.0);
        assert!(following.free_space_violation() < 0.06);
        assert_eq!((following.at(6), following.range()), (Some(1.5), [0.0, 0.0]));
    }

    fn followed(configurations: &[f64]) -> Following {
        bounded(configurations, &[])
    }

    fn bounded(configurations: &[f64], max_steps: &[f64]) -> Following {
        let pictures: Vec<RgbdFrame> = configurations.iter().map(|q| plate_at(*q)).collect();
        followed_in(&pictures, Search { range: [-0.2, 0.6], max_steps, ..Search::default() })
    }

    fn followed_in(pictures: &[RgbdFrame], search: Search) -> Following {
        let mut keyframes = Keyframes::new(pictures.len());
        for (f, picture) in pictures.iter().enumerate() {
            keyframes.offer(f, picture);
        }
        let camera_from_base = vec![Pose::identity(); pictures.len()];
        let ego_motion = EgoMotion { camera_from_base, ..EgoMotion::default() };
        let recording = Recording { tracks: TrackSet::default(), ego_motion, keyframes };
        let (front, geometry) = drawer();
        follow(&front, &geometry, 1.0, &search, &recording)
    }

    #[test]
    fn a_plain_surface_is_found_where_it_is_in_each_keyframe() {
        let truth = [0.0, 0.0, 0.1, 0.25, 0.4, 0.4, 0.2, 0.0];
        let following = followed(&truth);
        for (placed, q) in following.placements.iter().zip(truth) {
            assert!((placed.q - q).abs() < 0.002, "{} is told for {q}", placed.q);
        }
        assert!(following.free_space_violation() < 0.05 && following.shown_ratio() > 0.99);
        assert!(following.discriminability() > 0.4);
    }

    #[test]
    fn planes_tell_where_a_lid_is_that_leaves_a_surface_like_its_own() {
        // Half of what the lid covers is found behind it when it is raised, as the keyboard of a thin laptop.
        let raised = |q: f64| {
            seen(0, move |x, y| match (x.abs() < 0.2 && y.abs() < 0.15, x < 0.02) {
                (true, true) => 2.0,
                (true, false) => 2.0 - q,
                _ => 3.0,
            })
        };
        let truth = [0.0, 0.0, 0.3, 0.4, 0.4, 0.0];
        let pictures = truth.map(raised);
        let search = Search { range: [-0.2, 0.6], guided_to: 0.05, ..Search::default() };
        let by_depth = followed_in(&pictures, search);
        assert!(by_depth.range()[1] < 0.1, "{:?}", by_depth.range());
        let guides = [(2, 0.31), (3, 0.39), (4, 0.4)];
        let guided = followed_in(&pictures, Search { guides: &guides, ..search });
        for (frame, q) in truth.iter().enumerate() {
            assert!((guided.at(frame).unwrap() - q).abs() < 0.02, "{frame}");
        }
    }

    #[test]
    fn a_surface_that_jumps_makes_a_large_step() {
        let smooth = followed(&[0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.4]);
        let jumps = followed(&[0.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.4, 0.4]);
        assert!(smooth.largest_step() < 0.12 && jumps.largest_step() > 0.35);
    }

    #[test]
    fn a_following_with_a_bound_does_not_jump() {
        let truth = [0.0, 0.0, 0.5, 0.5, 0.5, 0.1, 0.1, 0.1];
        assert!(!followed(&truth).keeps_within(&[0.1; 7]));
        assert!(followed(&truth).keeps_within(&[0.5; 7]));
        let slow = bounded(&truth, &[0.1; 7]);
        assert!(slow.keeps_within(&[0.1; 7]));
        assert!((slow.at(7).unwrap() - 0.1).abs() < 0.002, "it is found again after the jump");
    }

    #[test]
    fn a_following_that_a_bound_holds_back_runs_at_it() {
        let jumps = [0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5];
        assert!(bounded(&jumps, &[0.1; 7]).longest_run_at(&[0.1; 7]) >= 3);
        let goes = [0.0, 0.0, 0.05, 0.12, 0.2, 0.26, 0.3, 0.3];
        assert_eq!(bounded(&goes, &[0.1; 7]).longest_run_at(&[0.1; 7]), 0);
    }

    #[test]
    fn a_plate_shows_the_face_that_is_turned_to_the_camera_and_none_from_its_edge() {
        let lid = Surface {
            points: vec![Point3::new(0.0, 0.0, 2.0)],
            normal: -Vector3::z(),
            back: vec![Point3::new(0.0, 0.0, 2.05); 2],
        };
        let turned =
            |angle: f64| rotation_about(&Point3::new(0.0, 0.0, 2.0), &Vector3::x_axis(), angle);
        assert_eq!(lid.in_sight(&turned(0.3)).len(), 1);
        assert_eq!(lid.in_sight(&turned(2.8)).len(), 2);
        assert!(lid.in_sight(&turned(1.55)).is_empty());
        // If only one face is known, nothing shows on which side it is seen.
        let face = Surface { back: Vec::new(), ..lid };
        assert_eq!(face.in_sight(&turned(2.8)).len(), 1);
    }

    #[test]
    fn an_end_that_shows_a_lid_from_its_edge_alone_does_not_tell_that_it_left() {
        let placed = |of: usize, agrees: usize| Placement {
            frame: 0,
            q: 0.0,
            found: FreeSpaceCounts { through: 0, agrees },
            aside: FreeSpaceCounts::default(),
            of,
        };
        let with_ends = |of: usize, agrees: usize| {
            let mut placements = vec![placed(100, 90); 12];
            placements[..4].fill(placed(of, agrees));
            Following { placements }
        };
        assert!(with_ends(100, 90).is_there_throughout());
        assert!(with_ends(0, 0).is_there_throughout(), "seen from its edge");
        assert!(!with_ends(100, 0).is_there_throughout(), "it comes");
    }

    #[test]
    fn of_a_surface_that_stands_still_the_pictures_tell_no_motion() {
        let [low, high] = followed(&[0.0; 8]).range();
        assert!(high - low < 0.03);
    }
}
