//! Which part does a pixel of a keyframe belong to? Each part's motion is a claim about where
//! the pixel's point must be in the other keyframes; their depth pictures say which claim
//! holds. What fits no claim (the person) belongs to nothing.

use crate::learn::ego_motion::coarse_sigma;
use crate::math::rigid::Pose;
use linkage_driver::RgbdFrame;
use nalgebra::{Point2, Point3};
use rayon::prelude::*;

/// A keyframe with the pose of every part: `camera_from_part`, mapping object coordinates at
/// configuration 0; `None` where a joint's configuration is not known.
pub struct PosedFrame<'f> {
    /// The frame.
    pub frame: &'f RgbdFrame,
    /// By part.
    pub camera_from_part: Vec<Option<Pose>>,
}

/// Pixels between labelled places.
pub const STEP: usize = 4;
/// Least distance between the claims of two parts in a frame that can tell them apart, metres.
const MIN_DIFFERENCE_M: f64 = 0.03;

/// Fewest frames that must show whether a claim holds.
const MIN_DECISIVE: f64 = 3.0;
/// Difference of luma that light and noise explain.
const MAX_LUMA_DIFFERENCE: u8 = 18;
/// Largest share of these frames that may contradict a claim.
const MAX_CONTRADICTION: f64 = 0.12;

/// Part of each place on a grid of [`STEP`] pixels.
pub struct LabelGrid {
    columns: usize,
    labels: Vec<Option<u16>>,
}

impl LabelGrid {
    /// The part at a pixel.
    pub fn at(&self, u: usize, v: usize) -> Option<u16> {
        self.labels.get((v / STEP) * self.columns + (u / STEP).min(self.columns - 1)).copied()?
    }
}

/// True when a place in a part's frame is near enough to the part's tracked features that it
/// may lie on it.
pub type NearPart<'n> = dyn Fn(usize, &Point3<f64>) -> bool + Sync + 'n;

/// Labels all places of `frames[index]`.
pub fn label(frames: &[PosedFrame], index: usize, near_part: &NearPart) -> LabelGrid {
    let picture = frames[index].frame;
    let columns = picture.camera.width.div_ceil(STEP);
    let rows = picture.camera.height.div_ceil(STEP);
    let labels = (0..columns * rows)
        .into_par_iter()
        .map(|i| {
            let (u, v) = ((i % columns) * STEP + STEP / 2, (i / columns) * STEP + STEP / 2);
            label_point(frames, index, (u, v), near_part)
        })
        .collect();
    LabelGrid { columns, labels }
}

/// True when the keyframes hold that a place, at `at_rest` in the part's frame and at `in_base`
/// when it was seen, lies on the part: not on the base, and not on a hand.
pub fn belongs(
    frames: &[PosedFrame],
    part: usize,
    at_rest: &Point3<f64>,
    in_base: &Point3<f64>,
) -> bool {
    let claims = [(0, *in_base), (part, *at_rest)];
    support(frames, None, part, at_rest, &claims).is_some_and(|share| share > 0.8)
}

fn label_point(
    frames: &[PosedFrame],
    index: usize,
    (u, v): (usize, usize),
    near_part: &NearPart,
) -> Option<u16> {
    let here = &frames[index];
    let in_camera = here.frame.point_at(u, v)?;
    let seen = Some((index, here.frame.color.luma_at(u, v)?));
    let claims: Vec<(usize, Point3<f64>)> = here
        .camera_from_part
        .iter()
        .enumerate()
        .filter_map(|(part, pose)| {
            let at_rest = pose.as_ref()?.inverse_transform_point(&in_camera);
            (part == 0 || near_part(part, &at_rest)).then_some((part, at_rest))
        })
        .collect();
    let supports: Vec<(Option<f64>, usize)> = claims
        .iter()
        .map(|&(part, at_rest)| (support(frames, seen, part, &at_rest, &claims), part))
        .collect();
    let mut supported: Vec<(f64, usize)> =
        supports.iter().map(|&(share, part)| (share.unwrap_or(0.0), part)).collect();
    supported.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (best, part) = *supported.first()?;
    // Two claims that hold equally well decide nothing. Near a part's axis nothing may speak for
    // the part; that does not make the place the base's.
    let rival = supported.get(1).map_or(0.0, |s| s.0);
    let undecided = part == 0 && supports.iter().any(|s| s.0.is_none());
    (best > 0.5 && best > rival + 0.2 && !undecided).then_some(part as u16)
}

/// A pixel or one beside it is about as bright.
fn shows(frame: &RgbdFrame, pixel: &Point2<f64>, wanted: u8) -> bool {
    const BESIDE: i64 = 2;
    let (u, v) = (pixel.x.round() as i64, pixel.y.round() as i64);
    (v - BESIDE..=v + BESIDE).flat_map(|y| (u - BESIDE..=u + BESIDE).map(move |x| (x, y))).any(
        |(x, y)| {
            let at = usize::try_from(x).ok().zip(usize::try_from(y).ok());
            at.and_then(|(x, y)| frame.color.luma_at(x, y))
                .is_some_and(|luma| luma.abs_diff(wanted) < MAX_LUMA_DIFFERENCE)
        },
    )
}

/// Share of the decisive frames that agree; `None` where too few are decisive, 0 where too many
/// contradict: a surface is hardly ever seen through, but a hand that holds it is, before it comes
/// and after it has left.
///
/// A frame is decisive where the claims differ; with one claim alone all are. `seen` is the
/// frame that the place was seen in, and its luma there: a surface that slides in its own plane
/// agrees in depth with any claim, but shows another place of its pattern.
fn support(
    frames: &[PosedFrame],
    seen: Option<(usize, u8)>,
    part: usize,
    at_rest: &Point3<f64>,
    claims: &[(usize, Point3<f64>)],
) -> Option<f64> {
    let (mut agree, mut against, mut decisive) = (0.0, 0.0, 0.0);
    for (i, other) in frames.iter().enumerate() {
        if seen.is_some_and(|(index, _)| i == index) {
            continue;
        }
        let Some(pose) = &other.camera_from_part[part] else { continue };
        let claimed = pose * at_rest;
        let differs = claims.iter().filter(|(p, _)| *p != part).all(|(p, rest)| {
            other.camera_from_part[*p]
                .as_ref()
                .is_some_and(|pose| (pose * rest - claimed).norm() > MIN_DIFFERENCE_M)
        });
        if !differs {
            continue;
        }
        let Some(pixel) = other.frame.camera.project(&claimed) else { continue };
        let Some(z) = other.frame.depth.at_nearest(pixel.x, pixel.y) else { continue };
        let margin = 0.012 + 3.0 * coarse_sigma(claimed.z);
        let difference = f64::from(z) - claimed.z;
        if difference > margin {
            against += 1.0;
            decisive += 1.0;
        } else if difference > -margin {
            let looks_alike = seen.is_none_or(|(_, luma)| shows(other.frame, &pixel, luma));
            agree += f64::from(u8::from(looks_alike));
            decisive += 1.0;
        }
    }
    if decisive < MIN_DECISIVE {
        return None;
    }
    Some(if against > MAX_CONTRADICTION * decisive { 0.0 } else { agree / decisive })
}
