//! Keeps a bounded, even selection of a recording's frames whole, for the appearance of the parts and for the
//! free-space test.

use linkage_frames::RgbdFrame;
use linkage_frames::depth::DepthSensor;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Shortest time to which a speed is applied, seconds, because keyframes may be close in time.
const MIN_INTERVAL_S: f64 = 0.15;

/// Bytes that the kept frames may take together: 48 frames of 640 x 480 take 103 MB, and 48 of 3840 x 2160 would take
/// 2.8 GB.
const MOST_BYTES: usize = 512 << 20;
/// Bytes of a pixel: colour, and depth as floats.
const BYTES_PER_PIXEL: usize = 3 + 4;
/// Fewest frames that are kept, however large they are.
const FEWEST: usize = 12;

/// At most `capacity` frames, evenly spread over all that were offered; fewer of a large camera.
#[derive(Debug, Clone)]
pub struct Keyframes {
    capacity: usize,
    stride: usize,
    frames: Vec<(usize, Arc<RgbdFrame>)>,
}

impl Keyframes {
    /// An empty selection with room for `capacity` frames, at least 2.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(2), stride: 1, frames: Vec::new() }
    }

    /// Takes a frame if it is at least a stride later than the last one. If the room is full, the stride is
    /// doubled and the selection is thinned first.
    pub fn offer(&mut self, index: usize, frame: &RgbdFrame) {
        if !self.is_due(index) {
            return;
        }
        if self.frames.len() >= self.room(frame.camera.width * frame.camera.height) {
            self.stride *= 2;
            self.keep_apart();
            if !self.is_due(index) {
                return;
            }
        }
        self.frames.push((index, Arc::new(frame.clone())));
    }

    /// Removes the frames that are not marked, gives the others their new numbers, and thins those that are
    /// then closer than a stride.
    pub fn keep_frames(&mut self, marks: &[bool]) {
        let before = |index: usize| marks[..index.min(marks.len())].iter().filter(|m| **m).count();
        self.frames.retain(|(index, _)| marks.get(*index).copied().unwrap_or(true));
        self.frames.iter_mut().for_each(|(index, _)| *index = before(*index));
        self.keep_apart();
    }

    /// Number of frames of so many pixels that are kept.
    fn room(&self, pixels: usize) -> usize {
        (MOST_BYTES / (BYTES_PER_PIXEL * pixels).max(1)).max(FEWEST).min(self.capacity)
    }

    fn is_due(&self, index: usize) -> bool {
        self.frames.last().is_none_or(|(last, _)| index >= last + self.stride)
    }

    /// Drops frames that are less than a stride later than the kept frame before.
    fn keep_apart(&mut self) {
        let mut before: Option<usize> = None;
        let stride = self.stride;
        self.frames.retain(|(index, _)| {
            let stays = before.is_none_or(|before| *index >= before + stride);
            if stays {
                before = Some(*index);
            }
            stays
        });
    }

    /// Frame numbers and frames, in time order.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &RgbdFrame)> {
        self.frames.iter().map(|(i, f)| (*i, &**f))
    }

    /// The keyframes of a span of frames; the frames themselves are shared.
    pub fn within(&self, frames: &RangeInclusive<usize>) -> Self {
        let kept = self.frames.iter().filter(|(index, _)| frames.contains(index));
        Self { frames: kept.cloned().collect(), ..*self }
    }

    /// Type of the sensor that measured the depth; the default type without a frame.
    pub fn depth_sensor(&self) -> DepthSensor {
        self.frames.first().map(|(_, frame)| frame.camera.depth_sensor).unwrap_or_default()
    }

    /// Largest motion of a part from each keyframe to the next, at `speed` per second; a shorter interval
    /// counts as `MIN_INTERVAL_S`.
    pub fn largest_steps(&self, speed: f64) -> Vec<f64> {
        let intervals = self.frames.windows(2).map(|w| w[1].1.utime.saturating_sub(w[0].1.utime));
        intervals.map(|us| speed * (us as f64 * 1e-6).max(MIN_INTERVAL_S)).collect()
    }

    /// Number of frames that are kept.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True if no frame is kept.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_frames::{ColorImage, DepthImage, PinholeCamera};

    #[test]
    fn frames_that_stay_get_their_new_numbers() {
        let camera = Arc::new(PinholeCamera {
            width: 1,
            height: 1,
            cx: 0.0,
            cy: 0.0,
            ..PinholeCamera::kinect()
        });
        let mut keyframes = Keyframes::new(8);
        for i in 0..6 {
            let color = ColorImage::new(1, 1, vec![0; 3]).unwrap();
            let depth = DepthImage::from_metres(1, 1, vec![1.0]).unwrap();
            let frame = RgbdFrame::new(i as i64, Arc::clone(&camera), color, depth).unwrap();
            keyframes.offer(i, &frame);
        }
        keyframes.keep_frames(&[true, false, true, true, false, true]);
        let kept: Vec<(usize, i64)> = keyframes.iter().map(|(i, f)| (i, f.utime)).collect();
        assert_eq!(kept, [(0, 0), (1, 2), (2, 3), (3, 5)]);
    }

    #[test]
    fn frames_of_a_large_camera_take_no_more_memory() {
        let keyframes = Keyframes::new(48);
        let room = |width: usize, height: usize| keyframes.room(width * height);
        assert_eq!([room(640, 480), room(1280, 720)], [48, 48]);
        assert_eq!([room(1920, 1080), room(3840, 2160)], [36, FEWEST]);
        assert_eq!(Keyframes::new(8).room(3840 * 2160), 8);
    }

    #[test]
    fn a_long_recording_keeps_a_bounded_even_choice() {
        let camera = Arc::new(PinholeCamera {
            width: 2,
            height: 2,
            cx: 0.5,
            cy: 0.5,
            ..PinholeCamera::kinect()
        });
        let mut keyframes = Keyframes::new(8);
        for i in 0..1000 {
            let color = ColorImage::new(2, 2, vec![0; 12]).unwrap();
            let depth = DepthImage::from_metres(2, 2, vec![1.0; 4]).unwrap();
            let frame = RgbdFrame::new(i as i64, Arc::clone(&camera), color, depth).unwrap();
            keyframes.offer(i, &frame);
        }
        let kept: Vec<usize> = keyframes.iter().map(|(i, _)| i).collect();
        assert_eq!(kept, [0, 128, 256, 384, 512, 640, 768, 896]);
    }
}
