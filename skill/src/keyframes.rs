//! A bounded, even selection of a recording's frames, kept whole: for the appearance of the
//! parts and for asking whether the space that a model claims was free.

use linkage_driver::RgbdFrame;
use std::sync::Arc;

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

    /// Takes a frame if it falls on the stride; thins all out when the room is full.
    pub fn offer(&mut self, index: usize, frame: &RgbdFrame) {
        if !index.is_multiple_of(self.stride) {
            return;
        }
        if self.frames.len() == self.capacity {
            self.stride *= 2;
            let stride = self.stride;
            self.frames.retain(|(i, _)| i.is_multiple_of(stride));
            if !index.is_multiple_of(stride) {
                return;
            }
        }
        self.frames.push((index, Arc::new(frame.clone())));
    }

    /// Frame numbers and frames, in time order.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &RgbdFrame)> {
        self.frames.iter().map(|(i, f)| (*i, &**f))
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
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};

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
