//! Counts what the keyframes say of a claim that a place belongs to a part.
//!
//! In: for each keyframe, whether its depth shows a surface at the claimed place, sees through it, or shows an occluder.
//! Out: how well the claim is supported, and whether it could still hold where no keyframe confirms it.

use linkage_frames::RgbdFrame;
use nalgebra::Point3;

/// Fewest decisive frames for a claim.
const MIN_DECISIVE: f64 = 3.0;
/// Largest share of the decisive frames that may contradict a claim.
const MAX_CONTRADICTION: f64 = 0.12;
/// Smallest share of the decisive frames in which depth alone determines the part, for the label to count as
/// determined by depth.
const TOLD_BY_DEPTH: f64 = 0.25;
/// Number of frames that see through a place from which the place does not belong to the base. Fewer see through
/// static surface; a person who stands beside the object for most of the time bends down at some time.
const SEEN_THROUGH_FRAMES: usize = 2;

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

/// What the frames say of a claim, in frames.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    /// Decisive frames in which a surface that looks like the place is where the claim puts it.
    agree: f64,
    /// Decisive frames that see through the claimed place.
    against: f64,
    /// Frames in which the claims predict different places and the claimed place is not occluded.
    decisive: f64,
    /// Frames that agree and in which depth contradicts all other claims.
    by_depth: f64,
    /// Frames in which an occluder stands before the claimed place.
    hidden: f64,
    /// Frames that see far through the claimed place and all around it, decisive or not.
    clearly_through: usize,
    /// True if some frame shows a surface at the claimed place.
    is_there: bool,
    /// Frames that see through the place before the first one in which a surface is there.
    through_first: usize,
    /// Frames that see through the place after the last one in which a surface is there.
    through_last: usize,
}

impl Tally {
    /// Adds a decisive frame that sees through the claimed place.
    pub fn add_through(&mut self) {
        self.against += 1.0;
        self.decisive += 1.0;
    }

    /// Adds a decisive frame in which a surface is at the claimed place. `is_alike`: it looks like the place;
    /// `is_by_depth`: depth contradicts all other claims.
    pub fn add_there(&mut self, is_alike: bool, is_by_depth: bool) {
        self.agree += f64::from(u8::from(is_alike));
        self.by_depth += f64::from(u8::from(is_alike && is_by_depth));
        self.decisive += 1.0;
    }

    /// Adds a frame in which an occluder stands before the claimed place.
    pub fn add_hidden(&mut self) {
        self.hidden += 1.0;
    }

    /// Adds a frame that sees far through the claimed place and all around it.
    pub fn add_clearly_through(&mut self) {
        self.clearly_through += 1;
    }

    /// Notes whether a surface is at the claimed place in the next frame, decisive or not: where all claims agree, a
    /// place that is seen through contradicts them all.
    pub fn note_presence(&mut self, verdict: Option<Verdict>) {
        match verdict {
            Some(Verdict::SeenThrough) => {
                self.through_first += usize::from(!self.is_there);
                self.through_last += 1;
            }
            Some(Verdict::There) => {
                self.is_there = true;
                self.through_last = 0;
            }
            Some(Verdict::Hidden) | None => {}
        }
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
        let is_contradicted =
            self.against > MAX_CONTRADICTION * self.decisive || self.came_or_left();
        Some(Support {
            share: if is_contradicted { 0.0 } else { self.agree / self.decisive },
            by_depth: self.by_depth >= TOLD_BY_DEPTH * self.decisive,
        })
    }

    /// True if what is at the place was not there at first, or is no longer there at last: the hand that holds the part
    /// moves with it, but comes and leaves. Never true of the base.
    fn came_or_left(&self) -> bool {
        self.through_first.max(self.through_last) >= SEEN_THROUGH_FRAMES
    }

    /// True if most decisive frames see through the place.
    pub fn is_vacated(&self) -> bool {
        self.against >= MIN_DECISIVE && self.against > 0.5 * self.decisive
    }

    /// True if hardly any frame sees through a place where the claim needs surface, although none may confirm it.
    pub fn is_unrefuted(&self) -> bool {
        let all = self.decisive + self.hidden;
        all >= MIN_DECISIVE && self.against <= MAX_CONTRADICTION * all && !self.came_or_left()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What these frames say: `t` there, `s` seen through, `h` hidden.
    fn tally(frames: &str) -> Tally {
        let mut tally = Tally::default();
        for frame in frames.chars() {
            let (verdict, add): (Verdict, fn(&mut Tally)) = match frame {
                't' => (Verdict::There, |tally| tally.add_there(true, true)),
                's' => (Verdict::SeenThrough, Tally::add_through),
                _ => (Verdict::Hidden, Tally::add_hidden),
            };
            tally.note_presence(Some(verdict));
            add(&mut tally);
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
        assert_eq!(share("ttsttsttst"), Some(0.0), "too many see through it");
        assert_eq!(share("tthhhhhhh"), None, "too few show anything");
    }

    #[test]
    fn what_comes_late_or_leaves_early_is_a_hand() {
        assert_eq!(share("ssttttttttttttttttttttt"), Some(0.0));
        assert_eq!(share("tttttttttttttttttttttss"), Some(0.0));
        assert!(share("tttttttttttsstttttttttttt").is_some_and(|share| share > 0.9), "noise");
    }

    #[test]
    fn a_place_that_is_empty_later_was_left() {
        assert!(tally("tssssss").is_vacated());
        assert!(!tally("tttttsss").is_vacated() && !tally("ss").is_vacated());
    }

    #[test]
    fn a_surface_that_turns_away_is_not_refuted_but_one_that_should_be_seen_is() {
        assert!(tally("hhhhhhhh").is_unrefuted() && tally("thhhhthh").is_unrefuted());
        assert!(!tally("hhhshshh").is_unrefuted());
        assert!(!tally("hh").is_unrefuted(), "too few frames");
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
