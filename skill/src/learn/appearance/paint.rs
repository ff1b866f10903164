//! The paint of a surface apart from the light on it. A plain door that turns reflects more or less
//! light from frame to frame; if that were averaged, a piece of it that is seen early only would
//! come out brighter than the piece beside it, and the door would look patterned.
//!
//! The colour of a piece in a keyframe is its paint plus the light on its face in that keyframe; both
//! are found by least squares, in turns.

use nalgebra::Vector3;
use std::collections::HashMap;

/// Rounds of the least squares. The steps of a third round are below one unit of lightness.
const ROUNDS: usize = 3;

/// Colour of a piece of surface in one keyframe: CIELAB, summed over its pixels.
#[derive(Debug, Clone, Copy)]
pub struct SeenColour {
    /// Number of the keyframe.
    pub keyframe: usize,
    sum: Vector3<f64>,
    count: f64,
}

impl SeenColour {
    /// The first pixel.
    pub fn new(keyframe: usize, lab: Vector3<f64>) -> Self {
        Self { keyframe, sum: lab, count: 1.0 }
    }

    /// One more pixel.
    pub fn add(&mut self, lab: Vector3<f64>) {
        self.sum += lab;
        self.count += 1.0;
    }
}

/// Part, and main direction of the normal: what one light falls on.
pub type Face = (u16, u8);

/// The paint of each piece of surface, CIELAB, from its face and the colours that it was seen in.
pub fn paints(pieces: &[(Face, &[SeenColour])]) -> Vec<Vector3<f64>> {
    let mut light: HashMap<(Face, usize), Vector3<f64>> = HashMap::new();
    let mut paints = paints_in(pieces, &light);
    for _ in 0..ROUNDS {
        let mut left: HashMap<(Face, usize), (Vector3<f64>, f64)> = HashMap::new();
        for ((face, seen), paint) in pieces.iter().zip(&paints) {
            for colour in *seen {
                let entry = left.entry((*face, colour.keyframe)).or_default();
                entry.0 += colour.sum - paint * colour.count;
                entry.1 += colour.count;
            }
        }
        light = left.into_iter().map(|(key, (sum, count))| (key, sum / count)).collect();
        paints = paints_in(pieces, &light);
    }
    paints
}

fn paints_in(
    pieces: &[(Face, &[SeenColour])],
    light: &HashMap<(Face, usize), Vector3<f64>>,
) -> Vec<Vector3<f64>> {
    let paint = |(face, seen): &(Face, &[SeenColour])| {
        let lit = |c: &SeenColour| light.get(&(*face, c.keyframe)).copied().unwrap_or_default();
        let sum: Vector3<f64> = seen.iter().map(|c| c.sum - lit(c) * c.count).sum();
        sum / seen.iter().map(|c| c.count).sum::<f64>()
    };
    pieces.iter().map(paint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_changes_leaves_a_plain_face_plain_and_a_pattern_as_it_is() {
        let light = [0.0, -10.0, -20.0, -30.0];
        // Piece, its lightness, and the keyframes that show it.
        let pattern = [(80.0, 0..4), (80.0, 0..2), (80.0, 2..4), (50.0, 1..4)];
        let seen: Vec<Vec<SeenColour>> = pattern
            .iter()
            .map(|(lightness, keyframes)| {
                let lit =
                    |k: usize| SeenColour::new(k, Vector3::new(lightness + light[k], 0.0, 5.0));
                keyframes.clone().map(lit).collect()
            })
            .collect();
        let pieces: Vec<(Face, &[SeenColour])> = seen.iter().map(|s| ((1, 4), &s[..])).collect();
        let paints = paints(&pieces);
        assert!((paints[0].x - paints[1].x).abs() < 2.5, "{paints:?}");
        assert!((paints[1].x - paints[2].x).abs() < 2.5, "{paints:?}");
        assert!((paints[0].x - paints[3].x - 30.0).abs() < 2.5, "{paints:?}");
        assert!(paints.iter().all(|p| (p.z - 5.0).abs() < 1e-9));
    }
}
