//! The latest frames of a camera that stands still, as one frame with less noise.
//!
//! In: frames in time order. Out: the last of them, each pixel averaged with those earlier frames that
//! show the same there: colours by their mean, depths by their median. What moves through the picture
//! stays where the last frame has it. Depth noise falls by about the square root of the frames, and
//! pixels that a structured-light camera reads now and then are filled.

use super::stillness::EdgeView;
use linkage_frames::{ColorImage, DepthImage, FrameError, RgbdFrame};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Most frames that are kept: a second of a camera at half its rate. More gain little and cost memory.
const MOST: usize = 15;
/// Most pixels of all frames that are kept, so that large pictures do not fill the memory: 15 frames of a
/// Kinect are 4.6 million.
const MOST_PIXELS: usize = 8_000_000;
/// Change of luma that noise explains, of 255.
const SAME_LUMA: i32 = 12;
/// Depths that are the same differ by less than this, metres, and this share of their square (1/m):
/// three standard deviations of a structured-light camera.
const SAME_DEPTH: [f64; 2] = [0.01, 0.009];

/// Frames since the camera last moved.
#[derive(Default)]
pub struct StillFrames {
    frames: VecDeque<RgbdFrame>,
}

impl StillFrames {
    /// Takes the next frame; those before it are dropped where the camera has moved since.
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

    /// Frames that the next [`StillFrames::fused`] makes one of.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True before the first frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// The last frame as it came.
    pub fn last(&self) -> Option<&RgbdFrame> {
        self.frames.back()
    }

    /// The last frame, with less noise; `None` before the first.
    ///
    /// # Errors
    /// None that a well-formed frame could cause.
    pub fn fused(&self) -> Result<Option<RgbdFrame>, FrameError> {
        let Some(last) = self.frames.back() else { return Ok(None) };
        // A camera may have moved slowly: each frame is compared with the last one, too.
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

/// Colour and depth (metres, NaN without) of one pixel.
fn fused_pixel(last: &RgbdFrame, same: &[&RgbdFrame], u: usize, v: usize) -> ([u8; 3], f32) {
    let now = last.color.at(u, v).unwrap_or_default();
    let z_now = last.depth.at(u, v);
    let mut sum = now.map(u32::from);
    let mut colors = 1;
    let mut depths: [f32; MOST] = [0.0; MOST];
    let mut found = 0;
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
        if let Some(z) =
            frame.depth.at(u, v).filter(|z| z_now.is_none_or(|now| is_same_depth(*z, now)))
        {
            depths[found] = z;
            found += 1;
        }
    }
    let rgb = sum.map(|s| ((s + colors / 2) / colors) as u8);
    // A reading that few frames have is noise at an edge.
    let is_known = z_now.is_some() || 2 * found > same.len();
    (rgb, if is_known { median(&mut depths[..found]) } else { f32::NAN })
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
}

fn is_same_depth(a: f32, b: f32) -> bool {
    let (a, b) = (f64::from(a), f64::from(b));
    (a - b).abs() < SAME_DEPTH[0] + SAME_DEPTH[1] * a * b
}

/// The pixel's luma hardly differs.
fn shows_the_same(a: &RgbdFrame, b: &RgbdFrame, u: usize, v: usize) -> bool {
    match (a.color.luma_at(u, v), b.color.luma_at(u, v)) {
        (Some(a), Some(b)) => (i32::from(a) - i32::from(b)).abs() <= SAME_LUMA,
        _ => false,
    }
}

/// Both frames are of one camera that stood still between them.
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
