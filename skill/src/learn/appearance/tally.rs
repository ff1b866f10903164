//! Counts what the keyframes say of a claim that a place belongs to a part.
//!
//! In: for each keyframe, whether its depth shows a surface at the claimed place, sees through it, or shows an
//! occluder.
//! Out: how well the claim is supported, and whether it could still hold where no keyframe confirms it.

use linkage_frames::RgbdFrame;
use nalgebra::Point3;

/// Fewest decisive frames for a claim.
const MIN_DECISIVE: usize = 3;
/// Largest share of the decisive frames that may contradict a claim.
const MAX_CONTRADICTION: f64 = 0.12;
/// Smallest share of the decisive frames in which depth alone determines the part, for the label to count as
/// determined by depth.
const TOLD_BY_DEPTH: f64 = 0.25;
/// Number of frames that see far through a place from which it does not belong to the base. Fewer see through static
/// surface; a person who stands beside the object for most of the time bends down at some time.
const SEEN_THROUGH_FRAMES: usize = 2;
/// Number of frames at either end, among those that show the place, from which what is there has come or left.
const CAME_FRAMES: usize = 2;

/// What a depth image shows at a place in the camera frame.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The surface lies at the place.
    There,
    /// The surface lies behind the place.
    SeenThrough,
    /// An occluder stands before the place.
    Hidden,
}

impl Verdict {
    /// The verdict of a depth image on a place; `None` outside of the image and where there is no depth.
    pub fn at(frame: &RgbdFrame, place: &Point3<f64>) -> Option<Self> {
        let pixel = frame.camera.project(place)?;
        let z = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?);
        let margin = 0.012 + 3.0 * frame.camera.depth_sensor.feature_sigma(place.z);
        Some(match z - place.z {
            difference if difference > margin => Self::SeenThrough,
            difference if difference > -margin => Self::There,
            _ => Self::Hidden,
        })
    }
}

/// How well the keyframes support a claim.
#[derive(Debug, Clone, Copy, Default)]
pub struct Support {
    /// Share of the decisive frames that agree.
    pub share: f64,
    /// True if depth contradicts all other claims in many of the decisive frames.
    pub by_depth: bool,
}

/// What the frames say of a claim: numbers of frames, which are added in the order of time.
///
/// A frame is decisive if the claims predict different places in it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    /// Decisive frames that show a surface at the claimed place, or see through it.
    decisive: usize,
    /// Decisive frames that show a surface that looks like the place.
    agree: usize,
    /// Decisive frames that see through the claimed place.
    against: usize,
    /// Frames that agree and in which depth contradicts all other claims.
    by_depth: usize,
    /// Decisive frames in which an occluder stands before the claimed place.
    hidden: usize,
    /// Frames that see far through the claimed place and all around it, decisive or not.
    clearly_through: usize,
    /// Frames that show a surface at the claimed place, decisive or not.
    present: usize,
    /// Frames that see through the claimed place, decisive or not.
    absent: usize,
    /// Those of `absent` before the first frame that shows a surface there.
    absent_first: usize,
    /// Those of `absent` after the last frame that shows a surface there.
    absent_last: usize,
}

impl Tally {
    /// Adds a decisive frame that sees through the claimed place.
    pub fn add_through(&mut self) {
        self.against += 1;
        self.decisive += 1;
    }

    /// Adds a decisive frame in which a surface is at the claimed place. `is_alike`: it looks like the place;
    /// `is_by_depth`: depth contradicts all other claims.
    pub fn add_there(&mut self, is_alike: bool, is_by_depth: bool) {
        self.agree += usize::from(is_alike);
        self.by_depth += usize::from(is_alike && is_by_depth);
        self.decisive += 1;
    }

    /// Adds a decisive frame in which an occluder stands before the claimed place.
    pub fn add_hidden(&mut self) {
        self.hidden += 1;
    }

    /// Adds a frame that sees far through the claimed place and all around it.
    pub fn add_clearly_through(&mut self) {
        self.clearly_through += 1;
    }

    /// Notes that a frame, decisive or not, shows a surface at the claimed place.
    pub fn note_present(&mut self) {
        self.present += 1;
        self.absent_last = 0;
    }

    /// Notes that a frame, decisive or not, sees through the claimed place: where all claims agree, that contradicts
    /// them all.
    pub fn note_absent(&mut self) {
        self.absent += 1;
        self.absent_first += usize::from(self.present == 0);
        self.absent_last += 1;
    }

    /// How well the decisive frames support the claim; `None` if too few are decisive, 0 if too many contradict. A
    /// surface is hardly ever seen through, but a hand that holds it is, before it comes and after it has left.
    pub fn support(&self) -> Option<Support> {
        if self.clearly_through >= SEEN_THROUGH_FRAMES {
            return Some(Support::default());
        }
        if self.decisive < MIN_DECISIVE {
            return None;
        }
        let decisive = self.decisive as f64;
        let is_contradicted =
            self.against as f64 > MAX_CONTRADICTION * decisive || self.came_or_left();
        Some(Support {
            share: if is_contradicted { 0.0 } else { self.agree as f64 / decisive },
            by_depth: self.by_depth as f64 >= TOLD_BY_DEPTH * decisive,
        })
    }

    /// True if what is at the place was not there at first, or is no longer there at last: the hand that holds the part
    /// moves with it, but comes and leaves.
    fn came_or_left(&self) -> bool {
        self.absent_first.max(self.absent_last) >= CAME_FRAMES
    }

    /// True if most decisive frames see through the place.
    pub fn is_vacated(&self) -> bool {
        self.against >= MIN_DECISIVE && 2 * self.against > self.decisive
    }

    /// True if the claim may hold although hardly any decisive frame can confirm it: several other frames show the
    /// place, nearly all decisive frames hide it, and hardly any frame sees through it.
    pub fn is_unrefuted(&self) -> bool {
        let all = (self.present + self.absent + self.hidden) as f64;
        self.present >= MIN_DECISIVE
            && self.decisive < MIN_DECISIVE.max(self.hidden)
            && (self.against.max(self.absent) as f64) <= MAX_CONTRADICTION * all
            && !self.came_or_left()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What these decisive frames say: `t` there, `o` another surface there, `s` seen through, `h` hidden; and in
    /// capitals what frames that are not decisive say.
    fn tally(frames: &str) -> Tally {
        let mut tally = Tally::default();
        for frame in frames.chars() {
            match frame {
                't' => tally.add_there(true, true),
                'o' => tally.add_there(false, false),
                's' => tally.add_through(),
                'h' => tally.add_hidden(),
                _ => {}
            }
            match frame.to_ascii_lowercase() {
                's' => tally.note_absent(),
                'h' => {}
                _ => tally.note_present(),
            }
        }
        tally
    }

    fn share(frames: &str) -> Option<f64> {
        tally(frames).support().map(|support| support.share)
    }

    #[test]
    fn a_claim_is_supported_by_the_frames_that_show_its_surface() {
        assert_eq!(share("tttttttttt"), Some(1.0));
        assert_eq!(share("tttttttttstt"), Some(11.0 / 12.0));
        assert_eq!(share("ttttto"), Some(5.0 / 6.0));
        assert_eq!(share("ttsttsttst"), Some(0.0), "too many see through it");
        assert_eq!(share("tthhhhhhh"), None, "too few show anything");
    }

    #[test]
    fn what_comes_late_or_leaves_early_is_a_hand() {
        assert_eq!(share("ssttttttttttttttttttttt"), Some(0.0));
        assert_eq!(share("tttttttttttttttttttttss"), Some(0.0));
        assert_eq!(share("SSTTtttttttTT"), Some(0.0), "also while the part is at rest");
        assert!(share("tttttttttttsstttttttttttt").is_some_and(|share| share > 0.9), "noise");
    }

    #[test]
    fn a_place_through_which_most_frames_see_is_vacated() {
        assert!(tally("tssssss").is_vacated());
        assert!(!tally("tttttsss").is_vacated() && !tally("ss").is_vacated());
    }

    #[test]
    fn a_face_that_turns_away_is_not_refuted() {
        assert!(tally("TTTThhhhhhhhTTT").is_unrefuted() && tally("TTTthhhhhhtTT").is_unrefuted());
    }

    #[test]
    fn a_face_that_should_be_seen_is_refuted_where_it_is_not_or_looks_otherwise() {
        assert!(!tally("TTTThhhshshhTTT").is_unrefuted(), "it is seen through");
        assert!(
            !tally("TTTTSSSSShhhhhTTT").is_unrefuted(),
            "a hand behind an open door comes and goes"
        );
        assert!(!tally("TTTTooooooooTTT").is_unrefuted(), "a hand lies on the part");
        assert!(!tally("hhhhhhhhhh").is_unrefuted(), "no other frame shows it");
    }

    #[test]
    fn static_surface_is_never_seen_far_through() {
        let mut seen = tally("tttttttttt");
        seen.add_clearly_through();
        assert_eq!(seen.support().map(|support| support.share), Some(1.0));
        seen.add_clearly_through();
        assert_eq!(seen.support().map(|support| support.share), Some(0.0));
    }
}
