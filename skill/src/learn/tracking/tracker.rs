//! Follows features from frame to frame, and starts new ones where there are none.
//!
//! In: RGB-D frames in the order of time.
//! Out: tracks, in pixels and in the camera frame of each frame, metres.
//! From: paper, section III-A.

use super::config::TrackConfig;
use super::corners;
use super::depth_lift::Lifter;
use super::descriptor::{Descriptors, describe, distance};
use super::flow::Picture;
use super::prediction::Prediction;
use super::track::{Track, TrackId, TrackSet};
use crate::image::gray::Gray;
use linkage_frames::RgbdFrame;
use nalgebra::{Point2, Point3};
use std::collections::HashSet;

/// Largest distance between the unit descriptors of one feature in two frames. Ours.
const MAX_DESCRIPTOR_DISTANCE: f64 = 0.45;
/// Smallest number of observations with depth of a track that takes part in learning. Original
/// code: 5.
const MIN_LENGTH: usize = 6;
/// Width of the image border in which a feature is given up, pixels.
const BORDER_PX: f32 = 5.0;

/// A live feature: its track, and its descriptor when the feature was last confirmed.
struct Feature {
    track: usize,
    pixel: Point2<f32>,
    description: Vec<f32>,
}

/// Follows features through a recording.
pub struct Tracker {
    config: TrackConfig,
    previous: Option<Picture>,
    live: Vec<Feature>,
    set: TrackSet,
    /// Number of tracks that were ever started.
    born: usize,
}

impl Tracker {
    /// Creates a tracker without frames.
    pub fn new(config: TrackConfig) -> Self {
        Self { config, previous: None, live: Vec::new(), set: TrackSet::default(), born: 0 }
    }

    /// Follows all features into `frame`, and starts new ones where there are none.
    pub fn push(&mut self, frame: &RgbdFrame) -> opencv::Result<()> {
        let gray = Gray::from_color(&frame.color)?.blurred(0.7)?;
        let picture = Picture::new(gray, self.config.flow)?;
        let index = self.set.frames();
        self.set.frame_utimes.push(frame.utime);
        self.follow(&picture)?;
        if index.is_multiple_of(self.config.detect_every.max(1)) {
            self.replenish(&picture.gray)?;
        }
        self.observe(frame, index);
        self.previous = Some(picture);
        Ok(())
    }

    /// Number of features alive in the newest frame.
    pub fn live_count(&self) -> usize {
        self.live.len()
    }

    /// Number of frames so far.
    pub fn frames(&self) -> usize {
        self.set.frames()
    }

    /// All tracks so far, the short ones too.
    pub fn seen(&self) -> &TrackSet {
        &self.set
    }

    /// Removes the frames that are not marked (the newest must be marked), and ended tracks that
    /// are too short to learn from. Returns the new number of each track that stays.
    pub fn keep_frames(&mut self, marks: &[bool]) -> Vec<Option<usize>> {
        let is_alive: HashSet<usize> = self.live.iter().map(|f| f.track).collect();
        for (number, track) in self.set.tracks.iter_mut().enumerate() {
            if !is_alive.contains(&number) && !track.is_long(MIN_LENGTH) {
                track.observations.clear();
            }
        }
        let numbers = self.set.keep_frames(marks);
        self.live.retain_mut(|feature| match numbers[feature.track] {
            Some(number) => {
                feature.track = number;
                true
            }
            None => false,
        });
        numbers
    }

    /// Track number and place, pixels, of each feature alive in the newest frame.
    pub fn live(&self) -> impl Iterator<Item = (usize, Point2<f32>)> + '_ {
        self.live.iter().map(|f| (f.track, f.pixel))
    }

    /// Features of the newest frame that have depth: the numbers of their tracks, and their places
    /// in the camera frame, metres.
    pub fn lifted(&self) -> Vec<(usize, Point3<f64>)> {
        let place = |f: &Feature| self.set.tracks[f.track].observations.last()?.point_in_camera;
        self.live.iter().filter_map(|f| Some((f.track, place(f)?))).collect()
    }

    /// The tracks that are long enough to learn from already.
    pub fn snapshot(&self) -> TrackSet {
        let long = |t: &&Track| t.is_long(MIN_LENGTH);
        TrackSet {
            frame_utimes: self.set.frame_utimes.clone(),
            tracks: self.set.tracks.iter().filter(long).cloned().collect(),
        }
    }

    /// All tracks that are long enough to learn from.
    pub fn finish(mut self) -> TrackSet {
        self.set.retain_long(MIN_LENGTH);
        self.set
    }

    fn follow(&mut self, picture: &Picture) -> opencv::Result<()> {
        let gray = &picture.gray;
        let Some(previous) = &self.previous else { return Ok(()) };
        let pixels: Vec<_> = self.live.iter().map(|f| f.pixel).collect();
        let predictions = previous.predict(picture, &pixels)?;
        let (width, height) = (gray.width() as f32, gray.height() as f32);
        let held = |p: &Prediction| {
            f64::from(p.forward_backward_px) <= self.config.max_forward_backward_px
                && p.pixel.x > BORDER_PX
                && p.pixel.y > BORDER_PX
                && p.pixel.x < width - BORDER_PX
                && p.pixel.y < height - BORDER_PX
        };
        let mut kept = Vec::with_capacity(self.live.len());
        for (mut feature, prediction) in std::mem::take(&mut self.live).into_iter().zip(predictions)
        {
            if let Some(prediction) = prediction.filter(held) {
                feature.pixel = prediction.pixel;
                kept.push(feature);
            }
        }
        self.reinforce(gray, &mut kept)?;
        self.live = self.verified(gray, kept)?;
        Ok(())
    }

    /// Reduces drift: moves a feature half way to a new corner that is close to its predicted
    /// place.
    fn reinforce(&self, gray: &Gray, features: &mut [Feature]) -> opencv::Result<()> {
        if self.config.reinforce_px <= 0.0 {
            return Ok(());
        }
        let fresh = corners::corners(gray, &[], 2 * self.config.max_features, &self.config)?;
        let grid = PixelGrid::new(&fresh);
        for feature in features {
            if let Some(corner) = grid.nearest(&feature.pixel, self.config.reinforce_px as f32) {
                // Half way: corners are found to whole pixels, flow to fractions of one.
                feature.pixel = nalgebra::center(&feature.pixel, &corner);
            }
        }
        Ok(())
    }

    /// Drops features whose descriptor has changed too much since they were last confirmed.
    fn verified(&self, gray: &Gray, features: Vec<Feature>) -> opencv::Result<Vec<Feature>> {
        let descriptions = self.describe(gray, &features)?;
        let mut kept = Vec::with_capacity(features.len());
        for (i, mut feature) in features.into_iter().enumerate() {
            let now = descriptions.get(i);
            if distance(&feature.description, now) <= MAX_DESCRIPTOR_DISTANCE {
                feature.description.clear();
                feature.description.extend_from_slice(now);
                kept.push(feature);
            }
        }
        Ok(kept)
    }

    fn describe(&self, gray: &Gray, features: &[Feature]) -> opencv::Result<Descriptors> {
        let pixels: Vec<_> = features.iter().map(|f| f.pixel).collect();
        describe(self.config.descriptor, gray, &pixels)
    }

    /// Adds features in regions that are not yet occupied, up to the configured number.
    fn replenish(&mut self, gray: &Gray) -> opencv::Result<()> {
        let wanted = self.config.max_features.saturating_sub(self.live.len());
        if wanted == 0 {
            return Ok(());
        }
        let occupied: Vec<_> = self.live.iter().map(|f| f.pixel).collect();
        let corners = corners::corners(gray, &occupied, wanted, &self.config)?;
        let descriptions = describe(self.config.descriptor, gray, &corners)?;
        let first_frame = self.set.frames() - 1;
        for (i, pixel) in corners.into_iter().enumerate() {
            let number = self.set.tracks.len();
            let description = descriptions.get(i).to_vec();
            self.live.push(Feature { track: number, pixel, description });
            let track = Track { id: TrackId(self.born), first_frame, observations: Vec::new() };
            self.set.tracks.push(track);
            self.born += 1;
        }
        Ok(())
    }

    fn observe(&mut self, frame: &RgbdFrame, index: usize) {
        let lifter = Lifter::new(frame, &self.config.lift);
        for feature in &self.live {
            let track = &mut self.set.tracks[feature.track];
            debug_assert_eq!(track.end_frame(), index);
            track.observations.push(lifter.observe(feature.pixel));
        }
    }
}

/// Corners in cells of 4 x 4 pixels, for nearest-neighbour queries within 4 pixels at most.
struct PixelGrid {
    cells: std::collections::HashMap<(i32, i32), Vec<Point2<f32>>>,
}

impl PixelGrid {
    const SIDE: f32 = 4.0;

    fn new(points: &[Point2<f32>]) -> Self {
        let mut cells: std::collections::HashMap<_, Vec<_>> = Default::default();
        for p in points {
            cells.entry(Self::cell(p)).or_default().push(*p);
        }
        Self { cells }
    }

    fn cell(p: &Point2<f32>) -> (i32, i32) {
        ((p.x / Self::SIDE).floor() as i32, (p.y / Self::SIDE).floor() as i32)
    }

    fn nearest(&self, p: &Point2<f32>, radius: f32) -> Option<Point2<f32>> {
        let (cx, cy) = Self::cell(p);
        (cy - 1..=cy + 1)
            .flat_map(|y| (cx - 1..=cx + 1).map(move |x| (x, y)))
            .filter_map(|cell| self.cells.get(&cell))
            .flatten()
            .map(|corner| ((corner - p).norm(), *corner))
            .filter(|(d, _)| *d <= radius.min(Self::SIDE))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, corner)| corner)
    }
}

#[cfg(test)]
mod tests {
    use super::super::descriptor::DescriptorKind;
    use super::*;
    use linkage_frames::{ColorImage, DepthImage, PinholeCamera};
    use std::sync::Arc;

    const SIDE: [usize; 2] = [320, 240];

    /// Smooth paint at 1.5 m, moved by so many pixels to the right.
    fn painted(shift: f64) -> RgbdFrame {
        painted_by(|u, v| {
            let waves = [(0.31, 0.12, 0.4), (-0.17, 0.37, 1.9), (0.12, -0.41, 2.7)];
            waves.iter().map(|(a, b, c)| (a * (u - shift) + b * v + c).sin()).sum()
        })
    }

    fn painted_by(paint: impl Fn(f64, f64) -> f64) -> RgbdFrame {
        let [width, height] = SIDE;
        let camera =
            PinholeCamera { width, height, cx: 160.0, cy: 120.0, ..PinholeCamera::kinect() };
        let grey = |i: usize| (127.5 + 40.0 * paint((i % width) as f64, (i / width) as f64)) as u8;
        let bytes = (0..width * height).flat_map(|i| [grey(i); 3]).collect();
        let color = ColorImage::new(width, height, bytes).unwrap();
        let depth = DepthImage::from_metres(width, height, vec![1.5; width * height]).unwrap();
        RgbdFrame::new(0, Arc::new(camera), color, depth).unwrap()
    }

    fn tracked(frames: &[RgbdFrame], config: TrackConfig) -> Tracker {
        let mut tracker = Tracker::new(config);
        frames.iter().for_each(|frame| tracker.push(frame).unwrap());
        tracker
    }

    fn moving(frames: usize) -> Vec<RgbdFrame> {
        (0..frames).map(|f| painted(2.0 * f as f64)).collect()
    }

    #[test]
    fn features_go_where_the_paint_goes() {
        let tracker = tracked(&moving(8), TrackConfig::default());
        let whole: Vec<&Track> =
            tracker.seen().tracks.iter().filter(|t| t.observations.len() == 8).collect();
        assert!(whole.len() > 100, "{}", whole.len());
        for track in whole {
            let [first, last] = [0, 7].map(|f| track.observations[f].pixel);
            let missed = (last - first - nalgebra::Vector2::new(14.0, 0.0)).norm();
            assert!(missed < 0.5, "{first} is followed to {last}");
            assert!((track.observations[7].point_in_camera.unwrap().z - 1.5).abs() < 1e-6);
        }
    }

    #[test]
    fn there_are_never_more_features_than_configured_and_each_has_its_own_track() {
        let config = TrackConfig { max_features: 60, ..TrackConfig::default() };
        let tracker = tracked(&moving(6), config);
        assert!((10..=60).contains(&tracker.live_count()), "{}", tracker.live_count());
        let mut numbers: Vec<usize> = tracker.live().map(|(number, _)| number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        assert_eq!(numbers.len(), tracker.live_count());
        let ids: Vec<TrackId> = tracker.seen().tracks.iter().map(|t| t.id).collect();
        assert!(ids.is_sorted_by(|a, b| a < b));
        let none = TrackConfig { max_features: 0, ..TrackConfig::default() };
        assert_eq!(tracked(&moving(2), none).seen().tracks.len(), 0);
    }

    #[test]
    fn no_feature_is_followed_into_another_picture() {
        let other = || painted_by(|u, v| (0.23 * u).sin() * (0.29 * v + 1.0).cos() * 2.0);
        for descriptor in [DescriptorKind::None, DescriptorKind::Sift] {
            let config = TrackConfig { descriptor, ..TrackConfig::default() };
            let tracker = tracked(&[painted(0.0), painted(0.0), other()], config);
            let born_first = tracker.seen().tracks.iter().filter(|t| t.first_frame == 0);
            let (mut all, mut followed) = (0, 0);
            for track in born_first {
                all += 1;
                followed += usize::from(track.end_frame() == 3);
            }
            assert!(all > 100 && 10 * followed < all, "{followed} of {all} with {descriptor:?}");
        }
    }

    #[test]
    fn what_was_seen_for_a_moment_is_not_learned_from() {
        assert!(
            tracked(&moving(MIN_LENGTH - 1), TrackConfig::default()).finish().tracks.is_empty()
        );
        let tracker = tracked(&moving(MIN_LENGTH), TrackConfig::default());
        let so_far = tracker.snapshot();
        let all = tracker.finish();
        assert!(!all.tracks.is_empty() && all.tracks.iter().all(|t| t.is_long(MIN_LENGTH)));
        assert_eq!(so_far.tracks.len(), all.tracks.len());
        assert_eq!(Tracker::new(TrackConfig::default()).finish().frames(), 0);
    }

    #[test]
    fn frames_are_forgotten_and_the_features_live_on_in_their_tracks() {
        let frames = moving(10);
        let mut tracker = tracked(&frames[..8], TrackConfig::default());
        let before: HashSet<TrackId> =
            tracker.live().map(|(number, _)| tracker.seen().tracks[number].id).collect();
        let numbers = tracker.keep_frames(&[true, false, true, false, true, false, false, true]);
        assert_eq!(tracker.frames(), 4);
        assert_eq!(numbers.iter().flatten().max(), Some(&(tracker.seen().tracks.len() - 1)));
        let after: HashSet<TrackId> =
            tracker.live().map(|(number, _)| tracker.seen().tracks[number].id).collect();
        assert_eq!(before, after);
        frames[8..].iter().for_each(|frame| tracker.push(frame).unwrap());
        let followed = tracker.seen().tracks.iter().filter(|t| t.end_frame() == 6);
        assert!(followed.filter(|t| before.contains(&t.id)).count() > 50);
    }

    #[test]
    fn the_nearest_corner_is_found_across_the_borders_of_cells_and_not_beyond_the_radius() {
        let grid = PixelGrid::new(&[Point2::new(3.9, 4.1), Point2::new(20.0, 20.0)]);
        assert_eq!(grid.nearest(&Point2::new(4.2, 3.8), 1.0), Some(Point2::new(3.9, 4.1)));
        assert_eq!(grid.nearest(&Point2::new(4.2, 3.8), 0.1), None);
        // A radius is no larger than a cell: what is farther would be found in some places only.
        assert_eq!(grid.nearest(&Point2::new(20.0, 25.0), 100.0), None);
        assert_eq!(grid.nearest(&Point2::new(f32::NAN, 0.0), 4.0), None);
        assert_eq!(PixelGrid::new(&[]).nearest(&Point2::new(1.0, 1.0), 4.0), None);
    }
}
