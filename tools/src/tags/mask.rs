//! A frame without its tags: plain colour where they are, and no depth there or at the rim, so
//! that nothing is learned from them.

use super::detector::{TagSighting, pixels_within};
use linkage_driver::{ColorImage, DepthImage, FrameError, RgbdFrame};

/// How much larger than the tag the plain patch is: tags have a white rim.
const COLOUR_GROWTH: f64 = 1.3;
/// And the hole in the depth, so that the patch's own corners have none.
const DEPTH_GROWTH: f64 = 1.6;

/// The frame with all tags masked.
///
/// # Errors
/// Never for a frame that was sound.
pub fn masked(frame: &RgbdFrame, tags: &[TagSighting]) -> Result<RgbdFrame, FrameError> {
    let (width, height) = (frame.color.width(), frame.color.height());
    let mut rgb = frame.color.as_rgb().to_vec();
    let mut metres = frame.depth.as_metres().to_vec();
    for tag in tags {
        let patch = pixels_within(&tag.grown(COLOUR_GROWTH), width, height);
        let mean: [u8; 3] = std::array::from_fn(|k| {
            let sum: usize =
                patch.iter().map(|(u, v)| usize::from(rgb[3 * (v * width + u) + k])).sum();
            (sum / patch.len().max(1)) as u8
        });
        for (u, v) in patch {
            let at = 3 * (v * width + u);
            rgb[at..at + 3].copy_from_slice(&mean);
        }
        for (u, v) in pixels_within(&tag.grown(DEPTH_GROWTH), width, height) {
            metres[v * width + u] = f32::NAN;
        }
    }
    RgbdFrame::new(
        frame.utime,
        frame.camera.clone(),
        ColorImage::new(width, height, rgb)?,
        DepthImage::from_metres(width, height, metres)?,
    )
}
