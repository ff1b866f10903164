//! Determines which part each pixel of a keyframe belongs to.
//!
//! Each part's motion is a claim: it predicts where the pixel's point must be in the other keyframes. Their depth
//! images confirm or contradict the claim. A point that fits no claim (on a person) belongs to nothing.
//!
//! In: keyframes with the pose of each part (camera_from_part).
//! Out: a label for each place on a grid of [`STEP`] pixels.

use super::dynamic_features::FrameFeatures;
use super::other_light::{has_same_contrast, is_same_under_other_light};
use super::tally::{Support, Tally, Verdict};
use crate::math::rigid::Pose;
use linkage_frames::{ColorImage, RgbdFrame};
use nalgebra::Point3;
use rayon::prelude::*;

/// A keyframe with the pose of every part: `camera_from_part` maps object coordinates at configuration 0 to the
/// camera frame; `None` where a joint's configuration is not known.
pub struct PosedFrame<'f> {
    /// The frame.
    pub frame: &'f RgbdFrame,
    /// Frame number in the demonstration.
    pub number: usize,
    /// Pose of each part; part 0 is the base.
    pub camera_from_part: Vec<Option<Pose>>,
}

/// Distance between labelled places, pixels.
pub const STEP: usize = 4;
/// Smallest distance between the places that two claims predict in a frame, metres, for the frame to discriminate
/// between them.
const MIN_DIFFERENCE_M: f64 = 0.03;

/// Difference of luma up to which two pixels count as equally bright: light and noise explain it.
const MAX_LUMA_DIFFERENCE: u8 = 18;
/// Turn of a part, radians, above which its colour is not compared, because it reflects other light. A drawer does
/// not turn: another hue where it was is the hand that pulled it.
const OTHER_LIGHT_RAD: f64 = 0.15;
/// Smallest distance from a place of the base that is seen through to the surface behind it, metres.
const FAR_BEHIND_M: f64 = 0.15;
/// Distance to the neighbouring pixels that must lie behind the place as well, pixels.
const AROUND_PX: f64 = 3.0;

/// Pixel in the middle of a place of a grid with this many columns.
pub fn pixel_of(place: usize, columns: usize) -> (usize, usize) {
    ((place % columns) * STEP + STEP / 2, (place / columns) * STEP + STEP / 2)
}

/// Label of each place on a grid of [`STEP`] pixels.
pub struct LabelGrid {
    columns: usize,
    labels: Vec<Label>,
}

/// Part that a place belongs to, or why there is none.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Label {
    /// Undecided: no claim is confirmed clearly.
    Nothing,
    /// The keyframes contradict all claims: the place moves by itself, as the person does.
    Foreign,
    /// A part, and what determined it.
    Part(Told),
    /// The depth agrees with the base, but features near the place move: a person stands there or reaches past it.
    /// Other keyframes decide between the two.
    Dynamic,
}

impl LabelGrid {
    /// The part at a pixel; also 0 where the depth agrees with the base but features near the pixel move.
    pub fn at(&self, u: usize, v: usize) -> Option<u16> {
        match self.label(u, v) {
            Some(Label::Part(told)) => Some(told.part),
            Some(Label::Dynamic) => Some(0),
            Some(Label::Nothing | Label::Foreign) | None => None,
        }
    }

    /// True if the depth of the pixel agrees with the base but features near it move.
    pub fn is_dynamic(&self, u: usize, v: usize) -> bool {
        self.label(u, v) == Some(Label::Dynamic)
    }

    /// True if neither the base nor a part moves as this place does.
    pub fn is_foreign(&self, u: usize, v: usize) -> bool {
        self.label(u, v) == Some(Label::Foreign)
    }

    /// Grid with this many places in a row.
    #[cfg(test)]
    pub fn of(columns: usize, told: Vec<Option<Told>>) -> Self {
        let labels =
            told.into_iter().map(|told| told.map_or(Label::Nothing, Label::Part)).collect();
        Self { columns, labels }
    }

    /// Number of places in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// For each place, row by row, the part and what determined it.
    pub fn told(&self) -> impl Iterator<Item = Option<Told>> + '_ {
        self.labels.iter().map(|label| match label {
            Label::Part(told) => Some(*told),
            Label::Dynamic | Label::Nothing | Label::Foreign => None,
        })
    }

    /// The grid without the labels of these places.
    pub fn without(&self, is_left_out: &[bool]) -> Self {
        let label = |(label, is_left_out): (&Label, &bool)| {
            if *is_left_out { Label::Nothing } else { *label }
        };
        Self {
            columns: self.columns,
            labels: self.labels.iter().zip(is_left_out).map(label).collect(),
        }
    }

    fn label(&self, u: usize, v: usize) -> Option<Label> {
        self.labels.get((v / STEP) * self.columns + (u / STEP).min(self.columns - 1)).copied()
    }
}

/// Function that is true if a point, in a part's frame at configuration 0, is so near to the part's known points that
/// it may lie on the part.
pub type NearPart<'n> = dyn Fn(usize, &Point3<f64>) -> bool + Sync + 'n;

/// Labels all places of `frames[index]`; `features` are those of that frame, camera frame.
pub fn label(
    frames: &[PosedFrame],
    index: usize,
    near_part: &NearPart,
    features: &FrameFeatures,
) -> LabelGrid {
    let picture = frames[index].frame;
    let columns = picture.camera.width.div_ceil(STEP);
    let rows = picture.camera.height.div_ceil(STEP);
    let labels = (0..columns * rows)
        .into_par_iter()
        .map(|i| {
            let (u, v) = pixel_of(i, columns);
            let moves = || picture.point_at(u, v).is_some_and(|p| features.are_dynamic_near(&p));
            match label_point(frames, index, (u, v), near_part) {
                None if is_foreign(frames, index, (u, v), near_part) => Label::Foreign,
                None => Label::Nothing,
                Some(Told { part: 0, .. }) if moves() => Label::Dynamic,
                Some(told) => Label::Part(told),
            }
        })
        .collect();
    LabelGrid { columns, labels }
}

/// True if the keyframes confirm that a point lies on the part, and not on the base or on a hand. `at_rest` is the
/// point in the part's frame at configuration 0, `in_base` where it was seen in the base frame.
pub fn belongs(
    frames: &[PosedFrame],
    part: usize,
    at_rest: &Point3<f64>,
    in_base: &Point3<f64>,
) -> bool {
    let claims = [(0, *in_base), (part, *at_rest)];
    tally_of_claim(frames, None, part, at_rest, &claims).support().is_some_and(|s| s.share > 0.8)
}

/// The part of the surface that a keyframe shows at a pixel, and what determined it; `None` if nothing does clearly.
pub fn label_point(
    frames: &[PosedFrame],
    index: usize,
    (u, v): (usize, usize),
    near_part: &NearPart,
) -> Option<Told> {
    let here = &frames[index];
    let in_camera = here.frame.point_at(u, v)?;
    let seen = Some(SeenPlace::new(frames, index, (u, v))?);
    let claims: Vec<(usize, Point3<f64>)> = here
        .camera_from_part
        .iter()
        .enumerate()
        .filter_map(|(part, pose)| {
            let at_rest = pose.as_ref()?.inverse_transform_point(&in_camera);
            (part == 0 || near_part(part, &at_rest)).then_some((part, at_rest))
        })
        .collect();
    let tallies: Vec<(Tally, usize)> = claims
        .iter()
        .map(|&(part, at_rest)| (tally_of_claim(frames, seen, part, &at_rest, &claims), part))
        .collect();
    told_by_support(&tallies).or_else(|| told_by_leaving(&tallies))
}

/// The part whose claim the decisive frames support, and clearly more than the claim of any other part.
fn told_by_support(tallies: &[(Tally, usize)]) -> Option<Told> {
    let support = |(tally, part): &(Tally, usize)| (tally.support().unwrap_or_default(), *part);
    let mut supported: Vec<(Support, usize)> = tallies.iter().map(support).collect();
    supported.sort_by(|a, b| b.0.share.total_cmp(&a.0.share));
    let (Support { share: best, by_depth }, part) = *supported.first()?;
    // Two claims that hold equally well decide nothing. Near a part's axis too few frames may be decisive for the
    // part; that does not make the place part of the base.
    let rival = supported.get(1).map_or(0.0, |s| s.0.share);
    let undecided = part == 0 && tallies.iter().any(|(tally, _)| tally.support().is_none());
    let is_told = best > 0.5 && best > rival + 0.2 && !undecided;
    let by = if by_depth { By::Depth } else { By::Colour };
    is_told.then_some(Told { part: part as u16, by })
}

/// The only part that may have been at a place through which most keyframes see, although hardly any keyframe confirms
/// the part: the outer face of a lid turns away from the camera.
fn told_by_leaving(tallies: &[(Tally, usize)]) -> Option<Told> {
    let is_vacated = tallies.iter().any(|(tally, part)| *part == 0 && tally.is_vacated());
    let mut may_be = tallies.iter().filter(|(tally, part)| *part > 0 && tally.is_unrefuted());
    let (_, part) = may_be.next()?;
    let is_told = is_vacated && may_be.next().is_none();
    is_told.then_some(Told { part: *part as u16, by: By::Leaving })
}

/// Share of the decisive frames that agree with a claim, below which the claim is contradicted.
const CONTRADICTED: f64 = 0.3;

/// True if the keyframes contradict every claim to a place, and the place is near no part, where keyframes are
/// sometimes wrong.
fn is_foreign(
    frames: &[PosedFrame],
    index: usize,
    (u, v): (usize, usize),
    near_part: &NearPart,
) -> bool {
    let here = &frames[index];
    let (Some(in_camera), Some(seen)) =
        (here.frame.point_at(u, v), SeenPlace::new(frames, index, (u, v)))
    else {
        return false;
    };
    here.camera_from_part.iter().enumerate().all(|(part, pose)| {
        let Some(pose) = pose else { return part > 0 };
        let at_rest = pose.inverse_transform_point(&in_camera);
        if part > 0 && near_part(part, &at_rest) {
            return false;
        }
        let of_claim = tally_of_claim(frames, Some(seen), part, &at_rest, &[(part, at_rest)]);
        of_claim.support().is_some_and(|support| support.share < CONTRADICTED)
    })
}

/// A place that a keyframe shows.
#[derive(Clone, Copy)]
struct SeenPlace<'f> {
    /// The keyframe.
    here: &'f PosedFrame<'f>,
    /// Index of the keyframe.
    index: usize,
    pixel: (usize, usize),
    luma: u8,
}

impl<'f> SeenPlace<'f> {
    /// The place at a pixel; `None` outside the image.
    fn new(frames: &'f [PosedFrame], index: usize, pixel: (usize, usize)) -> Option<Self> {
        let here = &frames[index];
        let luma = here.frame.color.luma_at(pixel.0, pixel.1)?;
        Some(Self { here, index, pixel, luma })
    }

    /// True if another frame shows the place with about the same colour where a part is claimed to be.
    ///
    /// On the base, and where depth contradicts all other claims, the light may have changed: a door that turns
    /// reflects more or less, and the shadow of an arm moves. Where depth does not discriminate, as for a part that
    /// slides in its own plane, brightness and contrast must both agree: at the border of a shadow the contrast
    /// differs.
    fn is_alike_in(
        &self,
        other: &PosedFrame,
        part: usize,
        claimed: &Point3<f64>,
        depth: Depth,
    ) -> bool {
        let is_as_bright = shows(other.frame, claimed, self.luma);
        match depth {
            Depth::TellsThisPart | Depth::IsAloneClaimed => {
                is_as_bright
                    || has_turned(self.here, other, part)
                    || self.is_so(other, claimed, is_same_under_other_light)
            }
            Depth::TellsNothing => is_as_bright && self.is_so(other, claimed, has_same_contrast),
        }
    }

    /// True if this frame sees through the place where the surface that another frame shows at `place` would have been,
    /// if that surface belonged to `part`.
    fn is_absent_from(&self, other: &PosedFrame, part: usize, place: &Point3<f64>) -> bool {
        let poses = self.here.camera_from_part[part].zip(other.camera_from_part[part]);
        let here = poses.map(|(here, other)| here * other.inverse_transform_point(place));
        here.and_then(|place| Verdict::at(self.here.frame, &place)) == Some(Verdict::SeenThrough)
    }

    fn is_so(
        &self,
        other: &PosedFrame,
        claimed: &Point3<f64>,
        compare: impl Fn((&ColorImage, [f64; 2]), (&ColorImage, [f64; 2])) -> bool,
    ) -> bool {
        let Some(there) = other.frame.camera.project(claimed) else { return false };
        let pixel = [self.pixel.0 as f64, self.pixel.1 as f64];
        compare((&self.here.frame.color, pixel), (&other.frame.color, [there.x, there.y]))
    }
}

/// What the depth of a frame determines about the claims to a place, one of which agrees with it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Depth {
    /// Depth contradicts all other claims.
    TellsThisPart,
    /// Depth does not contradict some other claim.
    TellsNothing,
    /// There is no other claim.
    IsAloneClaimed,
}

/// True if the pixel of a place, or one beside it, is about as bright as `wanted`.
fn shows(frame: &RgbdFrame, place: &Point3<f64>, wanted: u8) -> bool {
    const BESIDE: i64 = 2;
    let Some(pixel) = frame.camera.project(place) else { return false };
    let (u, v) = (pixel.x.round() as i64, pixel.y.round() as i64);
    (v - BESIDE..=v + BESIDE).flat_map(|y| (u - BESIDE..=u + BESIDE).map(move |x| (x, y))).any(
        |(x, y)| {
            let at = usize::try_from(x).ok().zip(usize::try_from(y).ok());
            at.and_then(|(x, y)| frame.color.luma_at(x, y))
                .is_some_and(|luma| luma.abs_diff(wanted) < MAX_LUMA_DIFFERENCE)
        },
    )
}

/// The part that a place belongs to, and what determined it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Told {
    /// Part number; 0 is the base.
    pub part: u16,
    /// What determined it.
    pub by: By,
}

/// What determined the part of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum By {
    /// The depth of many keyframes contradicts all other parts.
    Depth,
    /// The place looks the same in the keyframes, whose depth does not discriminate.
    Colour,
    /// Most keyframes see through the place, and hide where the part took it.
    Leaving,
}

/// What the frames say of a claim.
///
/// A frame is decisive if the places that the claims predict differ in it; with a single claim, all frames are.
/// `seen` is where the place was seen: a surface that slides in its own plane agrees in depth with any claim, but
/// shows another place of its pattern.
fn tally_of_claim(
    frames: &[PosedFrame],
    seen: Option<SeenPlace<'_>>,
    part: usize,
    at_rest: &Point3<f64>,
    claims: &[(usize, Point3<f64>)],
) -> Tally {
    let mut tally = Tally::default();
    for (i, other) in frames.iter().enumerate() {
        if seen.is_some_and(|seen| i == seen.index) {
            continue;
        }
        let Some(pose) = &other.camera_from_part[part] else { continue };
        let claimed = pose * at_rest;
        let Some(rivals) = rivals(other, part, claims) else { continue };
        let verdict = Verdict::at(other.frame, &claimed);
        let is_decisive =
            rivals.iter().all(|(_, rival)| (rival - claimed).norm() > MIN_DIFFERENCE_M);
        let may_be_empty = !is_decisive || verdict == Some(Verdict::SeenThrough);
        match verdict {
            _ if part == 0 => {
                if may_be_empty && is_seen_through(other.frame, &claimed) {
                    tally.add_clearly_through();
                }
            }
            Some(Verdict::There) => tally.note_present(),
            Some(Verdict::SeenThrough) => tally.note_absent(),
            Some(Verdict::Hidden) | None => {}
        }
        match verdict.filter(|_| is_decisive) {
            Some(Verdict::SeenThrough) => tally.add_through(),
            Some(Verdict::There) => {
                let depth = depth_tells(seen, other, &claimed, &rivals);
                let is_alike = seen.is_none_or(|s| s.is_alike_in(other, part, &claimed, depth));
                tally.add_there(is_alike, depth == Depth::TellsThisPart);
            }
            Some(Verdict::Hidden) => tally.add_hidden(),
            None => {}
        }
    }
    tally
}

/// The other claims, each with its place in a frame, camera frame; `None` if the pose of one of the parts is unknown.
fn rivals(
    frame: &PosedFrame,
    part: usize,
    claims: &[(usize, Point3<f64>)],
) -> Option<Vec<(usize, Point3<f64>)>> {
    let others = claims.iter().filter(|(other, _)| *other != part);
    others.map(|(p, rest)| Some((*p, frame.camera_from_part[*p].as_ref()? * rest))).collect()
}

/// What the depth of a frame that shows a surface at the claimed place tells about the rival claims.
fn depth_tells(
    seen: Option<SeenPlace<'_>>,
    other: &PosedFrame,
    claimed: &Point3<f64>,
    rivals: &[(usize, Point3<f64>)],
) -> Depth {
    let contradicts = |(rival, place): &(usize, Point3<f64>)| {
        match Verdict::at(other.frame, place) {
            Some(Verdict::SeenThrough) => true,
            // An occluder alone does not contradict: an arm passes over the floor.
            Some(Verdict::Hidden) => {
                seen.is_none_or(|seen| seen.is_absent_from(other, *rival, claimed))
            }
            Some(Verdict::There) | None => false,
        }
    };
    match rivals {
        [] => Depth::IsAloneClaimed,
        rivals if rivals.iter().all(contradicts) => Depth::TellsThisPart,
        _ => Depth::TellsNothing,
    }
}

/// True if a part's orientation in the base frame differs so much between two frames that the part may reflect other
/// light.
fn has_turned(a: &PosedFrame, b: &PosedFrame, part: usize) -> bool {
    let base_from_part = |frame: &PosedFrame| {
        let camera_from_base = frame.camera_from_part[0].as_ref()?;
        Some(camera_from_base.inverse() * frame.camera_from_part[part].as_ref()?)
    };
    base_from_part(a)
        .zip(base_from_part(b))
        .is_some_and(|(a, b)| a.rotation.angle_to(&b.rotation) > OTHER_LIGHT_RAD)
}

/// True if all that is seen at a place and around it lies far behind, so that no depth error at an edge explains it.
fn is_seen_through(frame: &RgbdFrame, place: &Point3<f64>) -> bool {
    let Some(pixel) = frame.camera.project(place) else { return false };
    let beside =
        [(0.0, 0.0), (-AROUND_PX, 0.0), (AROUND_PX, 0.0), (0.0, -AROUND_PX), (0.0, AROUND_PX)];
    beside.iter().all(|(x, y)| {
        let z = frame.depth.at_nearest(pixel.x + x, pixel.y + y);
        z.is_some_and(|z| f64::from(z) > place.z + FAR_BEHIND_M)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};
    use linkage_frames::ColorImage;
    use nalgebra::Vector3;

    const FRAMES: i64 = 20;
    const MIDDLE: (usize, usize) = (160, 120);
    const CORNER: (usize, usize) = (10, 10);

    fn with_luma(mut frame: RgbdFrame, luma: u8) -> RgbdFrame {
        let (width, height) = (frame.camera.width, frame.camera.height);
        frame.color = ColorImage::new(width, height, vec![luma; width * height * 3]).unwrap();
        frame
    }

    fn posed(frames: &[(RgbdFrame, Vec<Option<Pose>>)]) -> Vec<PosedFrame<'_>> {
        frames
            .iter()
            .map(|(frame, poses)| PosedFrame { frame, number: 0, camera_from_part: poses.clone() })
            .collect()
    }

    fn labelled(frames: &[(RgbdFrame, Vec<Option<Pose>>)], index: usize) -> LabelGrid {
        let posed = posed(frames);
        let near_part = |_: usize, p: &Point3<f64>| p.x.abs() < 0.25 && p.y.abs() < 0.25;
        label(&posed, index, &near_part, &FrameFeatures::default())
    }

    #[test]
    fn a_plain_part_that_turns_is_learned_though_the_light_on_it_changes() {
        let frame = |i: i64| {
            let slid = 0.02 * i as f64;
            let picture = with_luma(seen(i + 1, board(0.2, 1.5 - slid, 1.5)), 40 + 8 * i as u8);
            let front = Pose::new(Vector3::z() * -slid, Vector3::z() * (0.06 * i as f64));
            (picture, vec![Some(Pose::identity()), Some(front)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        for index in [0, 9, 19] {
            assert_eq!(labelled(&frames, index).at(MIDDLE.0, MIDDLE.1), Some(1), "frame {index}");
        }
    }

    #[test]
    fn a_plain_part_that_turns_in_its_own_plane_is_not_the_bases_because_the_light_changes() {
        let frame = |i: i64| {
            let picture = with_luma(seen(i + 1, board(0.2, 1.5, 3.0)), 40 + 8 * i as u8);
            let turned = Pose::new(Vector3::zeros(), Vector3::z() * (0.06 * i as f64));
            (picture, vec![Some(Pose::identity()), Some(turned)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        let beside_the_axis = (MIDDLE.0 + 25, MIDDLE.1);
        assert_ne!(labelled(&frames, 9).at(beside_the_axis.0, beside_the_axis.1), Some(0));
    }

    #[test]
    fn floor_that_an_arm_passes_over_is_not_determined_by_depth() {
        // A part slides by 2 cm a frame before the floor. An arm is over the left half of the floor from frame 4 on.
        let frame = |i: i64| {
            let left = if i < 4 { 2.0 } else { 1.0 };
            let slid = Pose::translation(0.02 * i as f64, 0.0, 0.0);
            let show = move |x: f64, _: f64| if x < 0.0 { left } else { 2.0 };
            (seen(i + 1, show), vec![Some(Pose::identity()), Some(slid)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        let posed = posed(&frames);
        let beside_the_arm = (MIDDLE.0 - 4, MIDDLE.1);
        let at_first = SeenPlace::new(&posed, 0, beside_the_arm);
        let place = posed[0].frame.point_at(beside_the_arm.0, beside_the_arm.1).unwrap();
        let claims = [(0, place), (1, place)];
        let floor = tally_of_claim(&posed, at_first, 1, &place, &claims).support().unwrap();
        assert!(floor.share > 0.9 && !floor.by_depth, "{floor:?}");
    }

    #[test]
    fn a_front_that_comes_towards_the_camera_is_determined_by_depth_although_it_hides_its_place() {
        let frame = |i: i64| {
            let slid = 0.02 * i as f64;
            let drawer = Pose::translation(0.0, 0.0, -slid);
            let show = board(0.2, 1.5 - slid, 1.5);
            (seen(i + 1, show), vec![Some(Pose::identity()), Some(drawer)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        let told = label_point(&posed(&frames), 0, MIDDLE, &|_, _| true);
        assert_eq!(told, Some(Told { part: 1, by: By::Depth }));
    }

    #[test]
    fn the_hand_that_comes_and_leaves_while_a_drawer_is_closed_is_none_of_it() {
        // The hand holds the front from frame 4 to frame 16, the drawer is open from frame 6 to frame 14.
        let slid = |i: i64| if (6..15).contains(&i) { 0.04 + 0.02 * (i - 6) as f64 } else { 0.0 };
        let frame = |i: i64| {
            let front = 1.5 - slid(i);
            let hand = if (4..17).contains(&i) { front - 0.1 } else { front };
            let show = move |x: f64, y: f64| match (x.abs().max(y.abs()), board(0.2, front, 1.5)) {
                (from_middle, _) if from_middle < 0.03 => hand,
                (_, board) => board(x, y),
            };
            let drawer = Pose::translation(0.0, 0.0, -slid(i));
            (seen(i + 1, show), vec![Some(Pose::identity()), Some(drawer)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        for index in [5, 10, 15] {
            let grid = labelled(&frames, index);
            assert_eq!(grid.at(MIDDLE.0, MIDDLE.1), None, "the hand in frame {index}");
            assert_eq!(grid.at(MIDDLE.0 + 20, MIDDLE.1), Some(1), "the front in frame {index}");
        }
    }

    #[test]
    fn the_face_of_a_part_that_moves_out_of_sight_is_the_parts() {
        // The part is gone from frame 8 on, to a place behind a pillar.
        let frame = |i: i64| {
            let (lid, moved) = if i < 8 { (1.5, 0.0) } else { (2.5, 0.7) };
            let show = move |x: f64, y: f64| if x > 0.3 { 1.0 } else { board(0.2, lid, 2.5)(x, y) };
            let away = Pose::translation(moved, 0.0, 0.0);
            (seen(i + 1, show), vec![Some(Pose::identity()), Some(away)])
        };
        let frames: Vec<_> = (0..FRAMES).map(frame).collect();
        let told = label_point(&posed(&frames), 2, MIDDLE, &|_, _| true);
        assert_eq!(told, Some(Told { part: 1, by: By::Leaving }));
    }

    /// Somebody stands before the wall in most of the frames.
    fn standing(away: impl Fn(i64) -> bool) -> Vec<(RgbdFrame, Vec<Option<Pose>>)> {
        let front = |i: i64| if away(i) { 2.0 } else { 1.5 };
        let frame = |i: i64| (seen(i + 1, board(0.2, front(i), 2.0)), vec![Some(Pose::identity())]);
        (0..FRAMES).map(frame).collect()
    }

    #[test]
    fn who_bends_down_twice_is_not_the_bases() {
        let grid = labelled(&standing(|i| i == 12 || i == 13), 0);
        assert_eq!(grid.at(MIDDLE.0, MIDDLE.1), None);
        assert_eq!(grid.at(CORNER.0, CORNER.1), Some(0));
        let grid = labelled(&standing(|_| false), 0);
        assert_eq!(grid.at(MIDDLE.0, MIDDLE.1), Some(0));
    }

    #[test]
    fn a_person_with_moving_features_is_dynamic() {
        let frames = standing(|_| false);
        let posed = posed(&frames);
        let dynamic = (0..4).map(|i| Point3::new(0.01 * f64::from(i), 0.0, 1.5)).collect();
        let features = FrameFeatures { dynamic, resting: Vec::new() };
        let grid = label(&posed, 0, &|_, _| false, &features);
        assert!(grid.is_dynamic(MIDDLE.0, MIDDLE.1));
        assert!(!grid.is_dynamic(CORNER.0, CORNER.1));
    }
}
