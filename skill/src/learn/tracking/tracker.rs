//! The tracker: one frame in, all tracks one frame longer.

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

/// Largest distance between unit descriptors of one feature. Ours.
const MAX_DESCRIPTOR_DISTANCE: f64 = 0.45;
/// Fewest observations of a track that takes part in learning. Original code: 5.
const MIN_LENGTH: usize = 6;
/// Pixels at the border in which a feature is given up.
const BORDER_PX: f32 = 5.0;

/// A live feature: its track and its description when it was last confirmed.
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
    /// Tracks that were ever started.
    born: usize,
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    pub fn new(config: TrackConfig) -> Self {
        Self { config, previous: None, live: Vec::new(), set: TrackSet::default(), born: 0 }
    }

    /// Follows all features into `frame` and starts new ones where none are.
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

    /// Features alive in the newest frame.
    pub fn live_count(&self) -> usize {
        self.live.len()
    }

    /// Frames seen so far.
    pub fn frames(&self) -> usize {
        self.set.frames()
    }

    /// What was seen so far.
    pub fn seen(&self) -> &TrackSet {
        &self.set
    }

    /// Forgets the frames that are not marked (the newest must be), and ended tracks that are too
    /// short to learn from. Gives the new number of each track that stays.
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

    /// Places and track numbers of the features alive in the newest frame.
    pub fn live(&self) -> impl Iterator<Item = (usize, Point2<f32>)> + '_ {
        self.live.iter().map(|f| (f.track, f.pixel))
    }

    /// Features lifted out of the newest frame: numbers of their tracks, and places in the camera
    /// frame.
    pub fn lifted(&self) -> Vec<(usize, Point3<f64>)> {
        let place = |f: &Feature| self.set.tracks[f.track].observations.last()?.point_in_camera;
        self.live.iter().filter_map(|f| Some((f.track, place(f)?))).collect()
    }

    /// Tracks that are long enough to learn from already.
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

    /// Combats drift: a fresh corner close to a prediction takes its place.
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

    /// Drops features that no longer look like themselves.
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

    /// Adds features in regions that are not yet occupied, up to the constant number.
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

/// Corners by cell, for nearest-neighbour queries of a pixel or two.
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
