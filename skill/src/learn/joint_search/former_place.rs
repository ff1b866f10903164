//! Former-place check of a joint: texture that a part has taken along is not seen any more where it was. The tracks
//! of a surface at rest can follow the border of what moves before it (a lid's edge above the keys of a piano) and seem
//! to move themselves; but their texture is still at its place in the other images.
//!
//! In: a joint with its tracks in the frame of its parent (metres), its parents, and the keyframes.
//! Out: the share of decisive comparisons, 0 to 1, in which the texture is still at its former place.
//! From: ours. Over the true joints of 72 recordings of the separate renderer the share was below 0.2; for the keys of a
//! piano it was 0.41 to 0.49.

use super::estimate::JointEstimate;
use super::free_space_check::FreeSpaceCheck;
use super::tracks_in_part_frame::TracksInFrame;
use crate::learn::free_space::{Probe, probe_point};
use crate::learn::recording::Recording;
use crate::math::rigid::Pose;
use linkage_frames::{ColorImage, RgbdFrame};
use nalgebra::{Point2, Point3};
use rayon::prelude::*;

/// Largest number of members that are compared.
const MAX_TRACKS: usize = 40;
/// Largest number of images that show a track and are compared with all others.
const MAX_IMAGES: usize = 6;
/// Fewest decisive comparisons from which a share is computed.
const MIN_DECISIVE: usize = 30;
/// Smallest distance in the image between the former place and the place to which the joint moves a point, pixels.
const APART_PX: f64 = 8.0;
/// Pixels on each side of a patch's middle.
const HALF_PX: i64 = 4;
/// Number of pixels of a patch.
const PATCH_PIXELS: usize = ((2 * HALF_PX + 1) * (2 * HALF_PX + 1)) as usize;
/// The best patch is searched up to this far to each side of a place, pixels, because the place has an error.
const SEARCH_PX: i64 = 2;
/// Smallest standard deviation of the brightness in a patch with texture, of 255.
const MIN_TEXTURE: f64 = 5.0;
/// Smallest correlation of two patches that show the same texture.
const SAME_TEXTURE: f64 = 0.8;
/// Smallest difference of the correlations at both places that decides between them.
const CLEARLY_MORE: f64 = 0.1;

/// What one comparison shows.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shown {
    /// The texture is still at its former place.
    Stayed,
    /// The texture is where the joint moves it, or the former place is empty.
    Moved,
}

/// Share of the decisive comparisons in which the texture of a joint's tracks is still at its former place, in the
/// frame of its parent; 0 where too few comparisons are decisive. `joints` holds the parents.
pub fn share_still_there(
    recording: &Recording,
    view: &TracksInFrame,
    joint: &JointEstimate,
    joints: &[JointEstimate],
) -> f64 {
    let check = FreeSpaceCheck { recording };
    let pictures: Vec<Picture> = recording
        .keyframes
        .iter()
        .filter(|(frame, _)| joint.known[*frame])
        .map(|(frame, picture)| {
            let camera_from_parent = check.camera_from_parent(joint, joints, frame);
            let parent_from_part = joint.dof.geometry().motion(joint.q[frame]);
            Picture { frame, picture, camera_from_parent, parent_from_part }
        })
        .collect();
    let stride = joint.members.len().div_ceil(MAX_TRACKS).max(1);
    let members: Vec<usize> = joint.members.iter().copied().step_by(stride).collect();
    let shown: Vec<Shown> =
        members.par_iter().flat_map_iter(|&track| shown_by(track, view, &pictures)).collect();
    let stayed = shown.iter().filter(|s| **s == Shown::Stayed).count();
    if shown.len() < MIN_DECISIVE { 0.0 } else { stayed as f64 / shown.len() as f64 }
}

/// A keyframe in which the configuration of the joint is known.
struct Picture<'r> {
    frame: usize,
    picture: &'r RgbdFrame,
    camera_from_parent: Pose,
    parent_from_part: Pose,
}

/// Compares some of the images that show a track with all others; indecisive comparisons are left out.
fn shown_by(track: usize, view: &TracksInFrame, pictures: &[Picture]) -> Vec<Shown> {
    let seen: Vec<(&Picture, Point3<f64>)> = pictures
        .iter()
        .filter_map(|from| Some((from, view.at(track, from.frame)?.point)))
        .collect();
    let stride = seen.len().div_ceil(MAX_IMAGES).max(1);
    let compared = seen.iter().step_by(stride);
    compared.flat_map(|(from, in_parent)| from.compare(in_parent, pictures)).collect()
}

impl Picture<'_> {
    /// Compares the texture at a point, which this image shows, with all other images.
    fn compare(&self, in_parent: &Point3<f64>, pictures: &[Picture]) -> Vec<Shown> {
        let own = self.pixel_of(in_parent).and_then(|pixel| patch(&self.picture.color, pixel));
        let Some(own) = own else { return Vec::new() };
        let in_part = self.parent_from_part.inverse_transform_point(in_parent);
        let others = pictures.iter().filter(|to| to.frame != self.frame);
        others
            .filter_map(|to| to.shows(&own, in_parent, &(to.parent_from_part * in_part)))
            .collect()
    }

    /// Pixel of a point in the parent's frame; `None` outside the image.
    fn pixel_of(&self, in_parent: &Point3<f64>) -> Option<Point2<f64>> {
        let camera = &self.picture.camera;
        let pixel = camera.project(&(self.camera_from_parent * in_parent))?;
        camera.sees(&pixel, (HALF_PX + SEARCH_PX + 1) as f64).then_some(pixel)
    }

    /// Whether the texture is still at its `former` place or where the joint moves it; `None` where both are near each
    /// other, one of them is outside the image, the former place is hidden, or neither place shows it clearly more than
    /// the other.
    fn shows(&self, own: &Patch, former: &Point3<f64>, moved: &Point3<f64>) -> Option<Shown> {
        let (former_pixel, moved_pixel) = (self.pixel_of(former)?, self.pixel_of(moved)?);
        if (former_pixel - moved_pixel).norm() < APART_PX {
            return None;
        }
        match probe_point(self.picture, &(self.camera_from_parent * former)) {
            Probe::Through => return Some(Shown::Moved),
            Probe::Unknown => return None,
            Probe::Agrees => {}
        }
        let at_former = likeness(own, &self.picture.color, former_pixel);
        let at_moved = likeness(own, &self.picture.color, moved_pixel);
        if at_former > SAME_TEXTURE && at_former > at_moved + CLEARLY_MORE {
            Some(Shown::Stayed)
        } else if at_moved > SAME_TEXTURE && at_moved > at_former + CLEARLY_MORE {
            Some(Shown::Moved)
        } else {
            None
        }
    }
}

/// Brightness around a pixel, with mean 0 and norm 1.
type Patch = [f64; PATCH_PIXELS];

/// The patch around a pixel; `None` outside the image or without texture.
fn patch(color: &ColorImage, pixel: Point2<f64>) -> Option<Patch> {
    let (u, v) = (pixel.x.round() as i64, pixel.y.round() as i64);
    let mut patch = [0.0; PATCH_PIXELS];
    let places = (-HALF_PX..=HALF_PX).flat_map(|y| (-HALF_PX..=HALF_PX).map(move |x| (x, y)));
    for (value, (x, y)) in patch.iter_mut().zip(places) {
        *value =
            f64::from(color.luma_at(usize::try_from(u + x).ok()?, usize::try_from(v + y).ok()?)?);
    }
    let mean = patch.iter().sum::<f64>() / PATCH_PIXELS as f64;
    patch.iter_mut().for_each(|value| *value -= mean);
    let norm = patch.iter().map(|value| value * value).sum::<f64>().sqrt();
    if norm < MIN_TEXTURE * (PATCH_PIXELS as f64).sqrt() {
        return None;
    }
    patch.iter_mut().for_each(|value| *value /= norm);
    Some(patch)
}

/// Largest correlation of a patch with those near a pixel; 0 where these have no texture.
fn likeness(own: &Patch, color: &ColorImage, pixel: Point2<f64>) -> f64 {
    let mut best: f64 = 0.0;
    for y in -SEARCH_PX..=SEARCH_PX {
        for x in -SEARCH_PX..=SEARCH_PX {
            let Some(other) = patch(color, Point2::new(pixel.x + x as f64, pixel.y + y as f64))
            else {
                continue;
            };
            best = best.max(own.iter().zip(&other).map(|(a, b)| a * b).sum());
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learn::ego_motion::EgoMotion;
    use crate::learn::joint_search::screw_joint::ScrewJoint;
    use crate::learn::joint_search::test_data::seen_moving;
    use crate::learn::keyframes::Keyframes;
    use crate::learn::tracking::TrackSet;
    use crate::test_data::{painted, patches};
    use nalgebra::Vector3;

    const FRAMES: usize = 10;
    /// Depth of the wall that the points are on, metres.
    const WALL_M: f64 = 1.5;

    /// Where the part is in a frame, metres along x.
    fn q(frame: usize) -> f64 {
        0.02 * frame as f64
    }

    /// How far the camera has gone along y in a frame, metres.
    fn of_camera(frame: usize) -> f64 {
        0.01 * frame as f64
    }

    /// How far the part that carries the joint has gone along y in a frame, metres.
    fn of_parent(frame: usize) -> f64 {
        0.025 * frame as f64
    }

    fn slide(
        axis: Vector3<f64>,
        q: fn(usize) -> f64,
        places: &[Point3<f64>],
    ) -> (TracksInFrame, JointEstimate) {
        let slide = ScrewJoint::slide(axis, Point3::origin());
        let configuration: Vec<f64> = (0..FRAMES).map(q).collect();
        let view = seen_moving(&slide, places, &configuration);
        let mut joint = JointEstimate::new(slide, &view, 0);
        (joint.q, joint.known) = (configuration, vec![true; FRAMES]);
        joint.members = (0..places.len()).collect();
        joint.summarise();
        (view, joint)
    }

    /// Share of comparisons for tracks that follow a slide along x over a wall, which its parent takes along y. In each
    /// frame, the paint of the wall has gone `paint_at` metres along x.
    fn share(paint_at: fn(usize) -> f64) -> f64 {
        let place = |i: i32| {
            Point3::new(0.05 * f64::from(i % 6) - 0.25, 0.05 * f64::from(i / 6) - 0.1, WALL_M)
        };
        let places: Vec<Point3<f64>> = (0..30).map(place).collect();
        let (view, mut joint) = slide(Vector3::x(), q, &places);
        joint.parent = Some(0);
        let (_, parent) = slide(Vector3::y(), of_parent, &places[..1]);
        let mut keyframes = Keyframes::new(FRAMES);
        for f in 0..FRAMES {
            let below = of_camera(f) - of_parent(f);
            let paint = |x: f64, y: f64| patches(1, WALL_M * x - paint_at(f), WALL_M * y + below);
            keyframes.offer(f, &painted(f as i64, |_, _| WALL_M, paint));
        }
        let camera_from_base =
            (0..FRAMES).map(|f| Pose::translation(0.0, -of_camera(f), 0.0)).collect();
        let ego_motion = EgoMotion { camera_from_base, ..EgoMotion::default() };
        let recording = Recording { tracks: TrackSet::default(), ego_motion, keyframes };
        share_still_there(&recording, &view, &joint, &[parent])
    }

    #[test]
    fn texture_that_went_along_is_not_at_its_former_place() {
        let share = share(q);
        assert!(share < 0.05, "{share}");
    }

    #[test]
    fn texture_that_stayed_on_the_parent_is_still_there_although_its_tracks_moved() {
        let share = share(|_| 0.0);
        assert!(share > 0.9, "{share}");
    }

    #[test]
    fn a_place_that_is_seen_empty_was_left_and_a_hidden_one_says_nothing() {
        let paint = |x: f64, y: f64| patches(1, x, y);
        let own =
            patch(&painted(0, |_, _| WALL_M, paint).color, Point2::new(160.0, 120.0)).unwrap();
        let shown = |depth: f64, moved_x: f64| {
            let picture = &painted(0, |_, _| depth, paint);
            let still = Pose::identity();
            let to =
                Picture { frame: 0, picture, camera_from_parent: still, parent_from_part: still };
            to.shows(&own, &Point3::new(0.0, 0.0, WALL_M), &Point3::new(moved_x, 0.0, WALL_M))
        };
        assert_eq!(shown(2.5, 0.2), Some(Shown::Moved));
        assert_eq!(shown(0.8, 0.2), None, "hidden");
        assert_eq!(shown(2.5, 0.001), None, "both places are near each other");
    }

    #[test]
    fn a_place_without_texture_or_at_the_border_says_nothing() {
        let plain = ColorImage::new(64, 64, vec![90; 64 * 64 * 3]).unwrap();
        assert!(patch(&plain, Point2::new(30.0, 30.0)).is_none());
        let textured = painted(0, |_, _| WALL_M, |x, y| patches(1, x, y)).color;
        assert!(patch(&textured, Point2::new(30.0, 30.0)).is_some());
        assert!(patch(&textured, Point2::new(2.0, 30.0)).is_none());
    }
}
