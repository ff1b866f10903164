//! A bounded, even selection of a recording's frames, kept whole: for the appearance of the
//! parts and for asking whether the space that a model claims was free.

use linkage_frames::RgbdFrame;
use linkage_frames::depth::DepthSensor;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Shortest time over which a speed is taken, seconds: keyframes may be close.
const MIN_INTERVAL_S: f64 = 0.15;

/// At most `capacity` frames, evenly spread over all that were offered.
#[derive(Debug, Clone)]
pub struct Keyframes {
    capacity: usize,
    stride: usize,
    frames: Vec<(usize, Arc<RgbdFrame>)>,
}

impl Keyframes {
    /// Keeps between half of `capacity` and all of it.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(2), stride: 1, frames: Vec::new() }
    }

    /// Takes a frame if it is a stride behind the last one; thins all out when the room is full.
    pub fn offer(&mut self, index: usize, frame: &RgbdFrame) {
        if !self.is_due(index) {
            return;
        }
        if self.frames.len() >= self.capacity {
            self.stride *= 2;
            self.keep_apart();
            if !self.is_due(index) {
                return;
            }
        }
        self.frames.push((index, Arc::new(frame.clone())));
    }

    /// Forgets the frames that are not marked, and gives the others their new numbers.
    pub fn keep_frames(&mut self, marks: &[bool]) {
        let before = |index: usize| marks[..index.min(marks.len())].iter().filter(|m| **m).count();
        self.frames.retain(|(index, _)| marks.get(*index).copied().unwrap_or(true));
        self.frames.iter_mut().for_each(|(index, _)| *index = before(*index));
        self.keep_apart();
    }

    fn is_due(&self, index: usize) -> bool {
        self.frames.last().is_none_or(|(last, _)| index >= last + self.stride)
    }

    /// Drops frames that are less than a stride behind the one before.
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

    /// Those of a span of frames; the frames themselves are shared.
    pub fn within(&self, frames: &RangeInclusive<usize>) -> Self {
        let kept = self.frames.iter().filter(|(index, _)| frames.contains(index));
        Self { frames: kept.cloned().collect(), ..*self }
    }

    /// What measured their depth.
    pub fn depth_sensor(&self) -> DepthSensor {
        self.frames.first().map(|(_, frame)| frame.camera.depth_sensor).unwrap_or_default()
    }

    /// Largest motion of a part from each keyframe to the next at a speed a second, taken over a short time at
    /// least.
    pub fn largest_steps(&self, speed: f64) -> Vec<f64> {
        let intervals = self.frames.windows(2).map(|w| w[1].1.utime.saturating_sub(w[0].1.utime));
        intervals.map(|us| speed * (us as f64 * 1e-6).max(MIN_INTERVAL_S)).collect()
    }

    /// How many are kept.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True before the first frame.
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
