//! Weighs features so that each area of the picture counts about alike. The checked shirt of a person has most of the
//! corners in many a plain room, and would be taken for the room.
//!
//! In: features with their map points, camera frame, metres. Out: their weights.
//! From: ours.

use crate::math::ransac::Correspondence;
use linkage_frames::PinholeCamera;

/// Number of cells across the picture; they are square.
const CELLS_ACROSS: usize = 13;
/// Most features that a cell counts for. Of ten recordings by a moving camera 1, 2 and 3 gave the same errors on
/// average.
const MOST_IN_CELL: f64 = 3.0;

/// Lowers the weights of features in those cells of the picture that have many.
pub fn balance(pairs: &mut [Correspondence], camera: &PinholeCamera) {
    let side = (camera.width as f64 / CELLS_ACROSS as f64).max(1.0);
    let down = (camera.height as f64 / side).ceil() as usize;
    let cell = |pair: &Correspondence| {
        let pixel = camera.project(&pair.to)?;
        let index = |at: f64, cells: usize| ((at / side).max(0.0) as usize).min(cells - 1);
        Some(index(pixel.y, down.max(1)) * CELLS_ACROSS + index(pixel.x, CELLS_ACROSS))
    };
    let cells: Vec<Option<usize>> = pairs.iter().map(cell).collect();
    let mut count = vec![0.0_f64; CELLS_ACROSS * down.max(1)];
    cells.iter().flatten().for_each(|&cell| count[cell] += 1.0);
    for (pair, cell) in pairs.iter_mut().zip(cells) {
        let in_cell = cell.map_or(1.0, |cell| count[cell]);
        pair.weight *= MOST_IN_CELL / in_cell.max(MOST_IN_CELL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn at(x: f64, y: f64) -> Correspondence {
        let place = Point3::new(x, y, 1.0);
        Correspondence { from: place, to: place, sigma: 0.01, weight: 1.0 }
    }

    #[test]
    fn many_features_in_one_place_count_as_few() {
        let camera = PinholeCamera::kinect();
        let mut pairs: Vec<Correspondence> =
            (0..30).map(|i| at(1e-5 * f64::from(i), 0.0)).collect();
        pairs.push(at(0.3, 0.2));
        balance(&mut pairs, &camera);
        let crowd: f64 = pairs[..30].iter().map(|p| p.weight).sum();
        assert!((crowd - MOST_IN_CELL).abs() < 1e-9, "{crowd}");
        assert_eq!(pairs[30].weight, 1.0);
    }

    #[test]
    fn a_feature_beyond_the_border_counts_in_the_outermost_cell() {
        let mut pairs = vec![at(-5.0, -5.0), at(5.0, 5.0)];
        balance(&mut pairs, &PinholeCamera::kinect());
        assert!(pairs.iter().all(|p| p.weight == 1.0));
    }
}
