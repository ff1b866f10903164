//! Fusion of the latest frames of a camera that stands still into one frame with less noise.
//!
//! In: frames in time order.
//! Out: the last frame, each pixel averaged with those earlier frames that show the same there: colours by their
//! mean, depths (metres) by their median. What moves stays where the last frame has it. Depth noise falls by about
//! the square root of the number of frames, and pixels that a structured-light camera reads only sometimes are
//! filled.

use super::stillness::EdgeView;
use linkage_frames::depth::DepthSensor;
use linkage_frames::{ColorImage, DepthImage, FrameError, RgbdFrame};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::f64::consts::SQRT_2;

/// Largest number of frames that are kept: one second of a camera at half its rate. More gain little and cost
/// memory.
const MOST: usize = 15;
/// Largest number of pixels of all frames that are kept, which bounds the memory: 15 frames of a Kinect have 4.6
/// million.
const MOST_PIXELS: usize = 8_000_000;
/// Largest change of luma, of 255, that noise explains.
const SAME_LUMA: i32 = 12;
/// Largest difference of two readings of one depth: in standard deviations of their difference, which is noisier than
/// one reading by the square root of two, and metres beyond that.
const SAME_DEPTH_SIGMAS: f64 = 3.0;
const SAME_DEPTH_M: f64 = 0.006;

/// Frames since the camera last moved.
#[derive(Default)]
pub struct StillFrames {
    frames: VecDeque<RgbdFrame>,
}

impl StillFrames {
    /// Appends the next frame; the earlier ones are dropped if the camera has moved since the last.
    pub fn push(&mut self, frame: RgbdFrame) {
        if self.frames.back().is_some_and(|last| !is_same_view(last, &frame)) {
            self.frames.clear();
        }
        let pixels = (frame.color.width() * frame.color.height()).max(1);
        self.frames.push_back(frame);
        while self.frames.len() > (MOST_PIXELS / pixels).clamp(1, MOST) {
            self.frames.pop_front();
        }
    }

    /// Number of frames that are kept; the next [`StillFrames::fused`] uses at most these.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True before the first frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// The last frame, unchanged.
    pub fn last(&self) -> Option<&RgbdFrame> {
        self.frames.back()
    }

    /// The last frame with less noise; `None` before the first frame.
    ///
    /// # Errors
    /// None for a well-formed frame.
    pub fn fused(&self) -> Result<Option<RgbdFrame>, FrameError> {
        let Some(last) = self.frames.back() else { return Ok(None) };
        // The camera may have moved slowly, so that each frame is also compared with the last one.
        let same: Vec<&RgbdFrame> =
            self.frames.iter().rev().skip(1).filter(|f| is_same_view(f, last)).collect();
        if same.is_empty() {
            return Ok(Some(last.clone()));
        }
        let (width, height) = (last.color.width(), last.color.height());
        let pixels: Vec<([u8; 3], f32)> = (0..width * height)
            .into_par_iter()
            .map(|i| fused_pixel(last, &same, i % width, i / width))
            .collect();
        let color =
            ColorImage::new(width, height, pixels.iter().flat_map(|(rgb, _)| *rgb).collect())?;
        let depth =
            DepthImage::from_metres(width, height, pixels.iter().map(|(_, z)| *z).collect())?;
        Ok(Some(RgbdFrame { color, depth, ..last.clone() }))
    }
}

/// Fused colour and depth (metres, NaN without) of one pixel.
fn fused_pixel(last: &RgbdFrame, same: &[&RgbdFrame], u: usize, v: usize) -> ([u8; 3], f32) {
    let now = last.color.at(u, v).unwrap_or_default();
    let z_now = last.depth.at(u, v);
    let mut sum = now.map(u32::from);
    let mut colors = 1;
    let mut depths: [f32; MOST] = [0.0; MOST];
    let mut found = 0;
    let sensor = last.camera.depth_sensor;
    let is_like_now = |z: &f32| z_now.is_none_or(|now| is_same_depth(sensor, *z, now));
    if let Some(z) = z_now {
        depths[0] = z;
        found = 1;
    }
    for frame in same {
        if !shows_the_same(last, frame, u, v) {
            continue;
        }
        let then = frame.color.at(u, v).unwrap_or(now);
        (0..3).for_each(|c| sum[c] += u32::from(then[c]));
        colors += 1;
        if let Some(z) = frame.depth.at(u, v).filter(is_like_now) {
            depths[found] = z;
            found += 1;
        }
    }
    let rgb = sum.map(|s| ((s + colors / 2) / colors) as u8);
    // Where the last frame has no depth, a reading in few frames is noise at an edge.
    let is_known = z_now.is_some() || 2 * found > same.len();
    (rgb, if is_known { median(&mut depths[..found]) } else { f32::NAN })
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
}

/// True if two readings of a sensor, metres, may be of one depth.
fn is_same_depth(sensor: DepthSensor, a: f32, b: f32) -> bool {
    let (a, b) = (f64::from(a), f64::from(b));
    let sigma = SQRT_2 * sensor.reading_sigma(0.5 * (a + b));
    (a - b).abs() < SAME_DEPTH_M + SAME_DEPTH_SIGMAS * sigma
}

/// True if the luma of a pixel differs by no more than noise.
fn shows_the_same(a: &RgbdFrame, b: &RgbdFrame, u: usize, v: usize) -> bool {
    match (a.color.luma_at(u, v), b.color.luma_at(u, v)) {
        (Some(a), Some(b)) => (i32::from(a) - i32::from(b)).abs() <= SAME_LUMA,
        _ => false,
    }
}

/// True if both frames are of one camera that stood still between them.
fn is_same_view(a: &RgbdFrame, b: &RgbdFrame) -> bool {
    let size = |f: &RgbdFrame| (f.color.width(), f.color.height());
    let luma = |f: &RgbdFrame, u: f64, v: f64| {
        f.color.luma_at(u as usize, v as usize).map(|luma| f64::from(luma) / 2.55)
    };
    size(a) == size(b)
        && a.camera == b.camera
        && EdgeView::of_lightness(size(a), |u, v| luma(a, u, v)).is_still_in(|u, v| luma(b, u, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::seen;

    /// A tiled wall 2 m away, its depth off by `error`, seen by a camera that is turned by some pixels,
    /// with a grey bar before it at some column.
    fn wall(shift_px: usize, bar_px: usize, error: impl Fn(usize) -> f32) -> RgbdFrame {
        let frame = seen(0, |_, _| 2.0);
        let (width, height) = (frame.camera.width, frame.camera.height);
        let pixels = || (0..width * height).map(|i| (i % width, i / width));
        let is_bar = |u: usize| (bar_px..bar_px + 20).contains(&u);
        let tile = |u: usize, v: usize| 90 + 80 * (((u + shift_px) / 24 + v / 24) % 2) as u8;
        let grey = pixels().flat_map(|(u, v)| [if is_bar(u) { 20 } else { tile(u, v) }; 3]);
        let metres = pixels().map(|(u, v)| if is_bar(u) { 1.0 } else { 2.0 + error(u + v) });
        RgbdFrame {
            color: ColorImage::new(width, height, grey.collect()).unwrap(),
            depth: DepthImage::from_metres(width, height, metres.collect()).unwrap(),
            ..frame
        }
    }

    /// Noise of up to 2 cm that differs from frame to frame.
    fn noise(frame: usize) -> impl Fn(usize) -> f32 {
        move |i| 0.02 * (((i * 7 + frame * 13) % 11) as f32 / 5.0 - 1.0)
    }

    fn fused(frames: impl IntoIterator<Item = RgbdFrame>) -> RgbdFrame {
        let mut still = StillFrames::default();
        frames.into_iter().for_each(|frame| still.push(frame));
        still.fused().unwrap().unwrap()
    }

    /// Root mean square error of the wall's depth, left of column 100.
    fn error(frame: &RgbdFrame) -> f64 {
        let squares: Vec<f64> = (0..100)
            .filter_map(|u| frame.depth.at(u, 60))
            .map(|z| (f64::from(z) - 2.0).powi(2))
            .collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    #[test]
    fn the_noise_of_a_still_camera_falls() {
        let one = wall(0, 120, noise(0));
        let many = fused((0..12).map(|f| wall(0, 120, noise(f))));
        assert!(error(&many) < 0.5 * error(&one), "{} of {}", error(&many), error(&one));
    }

    #[test]
    fn what_moves_stays_where_the_last_frame_has_it() {
        let all = fused((0..8).map(|f| wall(0, 10 + 12 * f, noise(f))));
        assert_eq!(all.depth.at(10 + 12 * 7 + 5, 60), Some(1.0));
        assert!(all.depth.at(15, 60).is_some_and(|z| z > 1.9), "where it was is the wall again");
    }

    #[test]
    fn frames_from_before_the_camera_moved_do_not_count() {
        let mut still = StillFrames::default();
        (0..4).for_each(|f| still.push(wall(0, 120, noise(f))));
        still.push(wall(24, 120, noise(5)));
        assert_eq!(still.len(), 1);
    }

    #[test]
    fn of_large_pictures_few_are_kept() {
        let stripes = || (0..6_000_000).flat_map(|i| [90 + 80 * ((i / 24) % 2) as u8; 3]).collect();
        let large = || RgbdFrame {
            color: ColorImage::new(3000, 2000, stripes()).unwrap(),
            depth: DepthImage::from_metres(3000, 2000, vec![1.0; 6_000_000]).unwrap(),
            ..seen(0, |_, _| 1.0)
        };
        let mut still = StillFrames::default();
        (0..3).for_each(|_| still.push(large()));
        assert_eq!(still.len(), 1);
    }

    #[test]
    fn a_reading_that_one_frame_has_is_no_reading() {
        let hole =
            |is_read: bool| wall(0, 120, move |i| if i == 80 && !is_read { f32::NAN } else { 0.0 });
        let seldom = fused([hole(false), hole(true), hole(false), hole(false), hole(false)]);
        let often = fused([hole(true), hole(true), hole(true), hole(true), hole(false)]);
        assert_eq!(seldom.depth.at(40, 40), None);
        assert_eq!(often.depth.at(40, 40), Some(2.0));
    }
}
