//! Whether a surface slides or turns, by how well keyframes agree with either motion.
//!
//! In: agreements of a slide and of the best hinge, 0 to 1, and the motion in radii of the surface.
//! Out: whether one of them excludes the other.
//! From: measurements, given at each limit and in `README.md`, "Slide or hinge?".

/// A slide may be accepted as a drawer if the best supported hinge agrees at most this fraction as well. It may then be
/// as far from the readings as depth noise is 2 m from the camera. Measured on those that turned in some way: drawers
/// 0.4 to 0.8, persons 0.88 to 2.
const CLEARLY_A_SLIDE: f64 = 0.75;
/// Limits for a slide of which it is not known whether it keeps its direction. The best hinge agreed 0.87 times as well
/// as a cooker's drawer, 1.14 times as well as a screen on an arm.
pub const SHORT: ShortSlide = ShortSlide { least_radii: 0.6, of_hinges: 0.9 };
/// Limits for a slide that keeps its direction. Doors that were opened a little, and seemed to slide without turning,
/// moved by 0.33 and 0.39 radii; a hinge explained them 1.1 to 1.4 times as well.
pub const SHORT_KEEPING_DIRECTION: ShortSlide = ShortSlide { least_radii: 0.4, of_hinges: 1.0 };
/// Ratios of a slide's agreement to a hinge's, above which the slide speaks against the hinge: in all keyframes, and
/// in those in which the part is away from its rest. Of seven parts that turned, the best slides had at most 0.83 and
/// 0.71, of a locker's door 0.95 and 0.49; of nine surfaces of drawers, sliding doors and persons at least 0.94 and
/// 0.59.
const AS_GOOD_AS_A_HINGE: [f64; 2] = [0.9, 0.55];

/// True if there are hinges to compare a slide with, and the best agrees much worse.
pub fn is_unlike_a_hinge(agreement: f64, of_hinges: f64) -> bool {
    of_hinges > 0.0 && of_hinges < CLEARLY_A_SLIDE * agreement
}

/// True if a slide agrees so well that it speaks against a hinge, both in all keyframes and away from the rest.
pub fn is_as_good(hinge: [f64; 2], slide: [f64; 2]) -> bool {
    (0..2).all(|k| slide[k] > AS_GOOD_AS_A_HINGE[k] * hinge[k])
}

/// When a slide is too short to distinguish it from a turn. A surface that moves as far as its radius about a line
/// beside it turns by a radian, which is distinguishable from a slide.
pub struct ShortSlide {
    /// Motion below which it is too short in any case, radii of the surface.
    least_radii: f64,
    /// Ratio of the best supported hinge's agreement to the slide's, above which a motion by less than a radius is too
    /// short.
    of_hinges: f64,
}

impl ShortSlide {
    /// True if a slide is too short to distinguish it from a turn about the best hinge.
    pub fn is_too_short(&self, way_in_radii: f64, agreement: f64, of_hinges: f64) -> bool {
        way_in_radii < self.least_radii
            || way_in_radii < 1.0 && of_hinges > self.of_hinges * agreement
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_slide_is_believed_only_where_no_hinge_agrees_nearly_as_well() {
        let is_doubted = |way: f64, hinges: f64| SHORT.is_too_short(way, 1.0, hinges);
        assert!(!is_doubted(1.2, 1.0), "it goes far");
        assert!(is_doubted(0.8, 0.95) && !is_doubted(0.8, 0.85), "a drawer has no such hinge");
        assert!(is_doubted(0.5, 0.0), "nothing tells so short a way from a turn");
    }

    #[test]
    fn a_shorter_slide_is_believed_if_it_keeps_its_direction() {
        let is_doubted =
            |way: f64, hinges: f64| SHORT_KEEPING_DIRECTION.is_too_short(way, 1.0, hinges);
        assert!(!is_doubted(0.5, 0.95), "the drawer of a medicine chest");
        assert!(is_doubted(0.5, 1.1), "a hinge explains it better");
        assert!(is_doubted(0.3, 0.0), "a door that is opened a little");
    }

    #[test]
    fn what_turns_about_a_line_nearly_as_well_is_not_clearly_a_slide() {
        assert!(is_unlike_a_hinge(0.55, 0.35), "a drawer");
        assert!(!is_unlike_a_hinge(0.4, 0.37), "a person");
        assert!(!is_unlike_a_hinge(0.5, 0.0), "nothing to compare it with");
    }

    #[test]
    fn what_slides_nearly_as_well_is_no_hinge() {
        assert!(is_as_good([0.61, 0.45], [0.58, 0.48]), "a sliding door in its plane");
        assert!(is_as_good([0.76, 0.63], [0.72, 0.37]), "a sleeve");
        assert!(!is_as_good([0.52, 0.45], [0.35, 0.21]), "a bin's lid");
        assert!(!is_as_good([0.5, 0.47], [0.47, 0.23]), "a door that rests most of the time");
    }
}
