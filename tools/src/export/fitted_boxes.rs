//! Few boxes round the surface of a part, where one would hold much that the part does not fill: a door
//! with a handle is a board and a bar.
//!
//! The box round all is cut in two wherever that leaves out most, then the pieces likewise. All boxes
//! are turned alike.

use super::cuboid::Cuboid;
use nalgebra::{UnitQuaternion, Vector3};

/// Most boxes of a part.
const MOST_BOXES: usize = 6;
/// A cut leaves out at least this share of the box round all.
const LEAST_GAIN: f64 = 0.15;
/// Places across each side of a box at which it is cut.
const CUTS: usize = 24;
/// Fewest places of the surface in a box.
const LEAST_PLACES: usize = 12;

/// Boxes round a surface, their sides along the axes of `rotation`; none with too little of it.
pub fn fitted_boxes(surface: &[Vector3<f64>], rotation: UnitQuaternion<f64>) -> Vec<Cuboid> {
    let Some(whole) = Cuboid::around(surface, rotation) else { return Vec::new() };
    let (low, high) = whole.corners_along_sides();
    let own = surface.iter().map(|place| rotation.inverse() * place);
    let mut pieces = vec![Piece::round(own.map(|p| p.sup(&low).inf(&high)).collect())];
    while pieces.len() < MOST_BOXES {
        let cuts = pieces.iter().enumerate().filter_map(|(i, piece)| Some((i, piece.best_cut()?)));
        let best = cuts.max_by(|(_, a), (_, b)| a.gain.total_cmp(&b.gain));
        let Some((i, cut)) = best.filter(|(_, cut)| cut.gain > LEAST_GAIN * whole.volume()) else {
            break;
        };
        pieces.swap_remove(i);
        pieces.extend(cut.halves);
    }
    pieces.into_iter().map(|p| Cuboid::between(p.low, p.high, rotation)).collect()
}

/// Places of the surface and the box round them, in the boxes' own axes.
struct Piece {
    places: Vec<Vector3<f64>>,
    low: Vector3<f64>,
    high: Vector3<f64>,
}

/// A piece in two.
struct Cut {
    /// Volume that the two leave out, cubic metres.
    gain: f64,
    halves: [Piece; 2],
}

impl Piece {
    fn round(places: Vec<Vector3<f64>>) -> Self {
        let low = places.iter().fold(Vector3::repeat(f64::MAX), |a, b| a.inf(b));
        let high = places.iter().fold(Vector3::repeat(f64::MIN), |a, b| a.sup(b));
        Self { places, low, high }
    }

    fn volume(&self) -> f64 {
        Cuboid::between(self.low, self.high, UnitQuaternion::identity()).volume()
    }

    fn best_cut(&self) -> Option<Cut> {
        let places = (0..3).flat_map(|axis| (1..CUTS).map(move |i| (axis, i)));
        let cuts = places.filter_map(|(axis, i)| {
            let share = i as f64 / CUTS as f64;
            self.cut(axis, self.low[axis] + share * (self.high[axis] - self.low[axis]))
        });
        cuts.max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// In two at a place along an axis; `None` where one of them would hold too little.
    fn cut(&self, axis: usize, at: f64) -> Option<Cut> {
        let (below, above): (Vec<_>, Vec<_>) = self.places.iter().partition(|p| p[axis] < at);
        if below.len().min(above.len()) < LEAST_PLACES {
            return None;
        }
        let halves = [below, above].map(Self::round);
        Some(Cut { gain: self.volume() - halves[0].volume() - halves[1].volume(), halves })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of a rectangle, 1 cm apart.
    fn plate(low: [f64; 3], [a, b]: [usize; 2], [along, up]: [usize; 2]) -> Vec<Vector3<f64>> {
        let step = |axis: usize, count: usize| 0.01 * count as f64 * Vector3::ith(axis, 1.0);
        let all = (0..=a).flat_map(move |i| (0..=b).map(move |k| (i, k)));
        all.map(|(i, k)| Vector3::from(low) + step(along, i) + step(up, k)).collect()
    }

    fn door_with_a_handle() -> Vec<Vector3<f64>> {
        let door = plate([0.0, 0.0, 0.0], [60, 80], [0, 1]);
        let bar = plate([0.5, 0.3, 0.06], [2, 20], [0, 1]);
        [door, bar].concat()
    }

    #[test]
    fn a_door_with_a_handle_is_a_board_and_a_bar_however_it_is_turned() {
        for rotation in
            [UnitQuaternion::identity(), UnitQuaternion::from_euler_angles(0.4, 1.0, -0.3)]
        {
            let surface: Vec<_> = door_with_a_handle().iter().map(|p| rotation * p).collect();
            let mut boxes = fitted_boxes(&surface, rotation);
            boxes.sort_by(|a, b| b.volume().total_cmp(&a.volume()));
            assert_eq!(boxes.len(), 2, "{boxes:?}");
            let off = |of: &Cuboid, wanted: [f64; 3]| (of.size - Vector3::from(wanted)).amax();
            assert!(off(&boxes[0], [0.6, 0.8, 0.01]) < 0.02, "{}", boxes[0].size);
            assert!(off(&boxes[1], [0.02, 0.2, 0.01]) < 0.02, "{}", boxes[1].size);
        }
    }

    #[test]
    fn what_fills_its_box_is_one_and_too_little_is_none() {
        let front = plate([0.0, 0.0, 0.0], [40, 20], [0, 1]);
        let back = plate([0.0, 0.0, 0.3], [40, 20], [0, 1]);
        let sides = [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]].map(|at| plate(at, [20, 30], [1, 2]));
        let drawer = [front.clone(), back, sides.concat()].concat();
        assert_eq!(fitted_boxes(&drawer, UnitQuaternion::identity()).len(), 1);
        assert_eq!(fitted_boxes(&front, UnitQuaternion::identity()).len(), 1);
        assert!(fitted_boxes(&front[..5], UnitQuaternion::identity()).is_empty());
    }
}
