//! The paint of a surface apart from the light on it. A plain door that turns reflects more or less
//! light from frame to frame; if that were averaged, a piece of it that is seen early only would
//! come out brighter than the piece beside it, and the door would look patterned.
//!
//! The colour of a piece in a keyframe is its paint plus the light on its face in that keyframe; both
//! are found by least squares, in turns. What the keyframes then disagree about (shadows, highlights,
//! errors of pose) is noise: neighbouring pieces keep as much of their difference as the
//! noise does not explain (a Wiener filter), so that recognition does not look for it.

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

/// A piece of surface.
#[derive(Debug, Clone, Copy)]
pub struct Piece<'c> {
    /// What the light falls on.
    pub face: Face,
    /// Pieces of one face and one neighbourhood are compared with each other.
    pub neighbourhood: [i32; 3],
    /// The colours that it was seen in, one a keyframe.
    pub seen: &'c [SeenColour],
}

/// The paint of each piece of surface, CIELAB.
pub fn paints(pieces: &[Piece]) -> Vec<Vector3<f64>> {
    let (mut paints, light) = paints_and_light(pieces);
    let mut neighbours: HashMap<(Face, [i32; 3]), Vec<usize>> = HashMap::new();
    for (i, piece) in pieces.iter().enumerate() {
        neighbours.entry((piece.face, piece.neighbourhood)).or_default().push(i);
    }
    for members in neighbours.values() {
        without_noise(pieces, members, &light, &mut paints);
    }
    paints
}

/// The light on a face in a keyframe.
type Light = HashMap<(Face, usize), Vector3<f64>>;

fn paints_and_light(pieces: &[Piece]) -> (Vec<Vector3<f64>>, Light) {
    let mut light = Light::new();
    let mut paints = paints_in(pieces, &light);
    for _ in 0..ROUNDS {
        let mut left: HashMap<(Face, usize), (Vector3<f64>, f64)> = HashMap::new();
        for (piece, paint) in pieces.iter().zip(&paints) {
            for colour in piece.seen {
                let entry = left.entry((piece.face, colour.keyframe)).or_default();
                entry.0 += colour.sum - paint * colour.count;
                entry.1 += colour.count;
            }
        }
        light = left.into_iter().map(|(key, (sum, count))| (key, sum / count)).collect();
        paints = paints_in(pieces, &light);
    }
    (paints, light)
}

impl Piece<'_> {
    /// Its colours without the light, with the pixels of each.
    fn unlit<'a>(&'a self, light: &'a Light) -> impl Iterator<Item = (Vector3<f64>, f64)> + 'a {
        self.seen.iter().map(|c| {
            let lit = light.get(&(self.face, c.keyframe)).copied().unwrap_or_default();
            (c.sum / c.count - lit, c.count)
        })
    }
}

fn paints_in(pieces: &[Piece], light: &Light) -> Vec<Vector3<f64>> {
    let paint = |piece: &Piece| {
        let (sum, count) = piece
            .unlit(light)
            .fold((Vector3::zeros(), 0.0), |(s, n), (c, count)| (s + c * count, n + count));
        sum / count
    };
    pieces.iter().map(paint).collect()
}

/// Takes from the paints of neighbours what their keyframes do not agree about.
fn without_noise(pieces: &[Piece], members: &[usize], light: &Light, paints: &mut [Vector3<f64>]) {
    let n = members.len() as f64;
    let mean = members.iter().map(|&i| paints[i]).sum::<Vector3<f64>>() / n;
    let between = members.iter().map(|&i| (paints[i] - mean).norm_squared()).sum::<f64>() / n;
    let disagreement = |&i: &usize| {
        let squares = pieces[i].unlit(light).map(|(c, _)| (c - paints[i]).norm_squared());
        (squares.sum::<f64>(), pieces[i].seen.len() as f64 - 1.0)
    };
    let (squares, degrees) =
        members.iter().map(disagreement).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    // The variance of one keyframe's colour, and that of a piece's mean.
    let single = squares / degrees.max(1.0);
    let noise = |i: usize| single / pieces[i].seen.len() as f64;
    let signal = (between - members.iter().map(|&i| noise(i)).sum::<f64>() / n).max(0.0);
    for &i in members {
        let kept = if signal > 0.0 { signal / (signal + noise(i)) } else { 0.0 };
        paints[i] = mean + (paints[i] - mean) * kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(colours: &[(usize, f64)]) -> Vec<SeenColour> {
        let lit = |&(k, l): &(usize, f64)| SeenColour::new(k, Vector3::new(l, 0.0, 5.0));
        colours.iter().map(lit).collect()
    }

    fn paints_of(seen: &[Vec<SeenColour>]) -> Vec<Vector3<f64>> {
        let piece = |seen| Piece { face: (1, 4), neighbourhood: [0; 3], seen };
        paints(&seen.iter().map(|s| piece(&s[..])).collect::<Vec<_>>())
    }

    #[test]
    fn light_that_changes_leaves_a_plain_face_plain_and_a_pattern_as_it_is() {
        let light = [0.0, -10.0, -20.0, -30.0];
        // Pieces: their lightness, and the keyframes that show them.
        let pattern = [(80.0, 0..4), (80.0, 0..2), (80.0, 2..4), (50.0, 1..4)];
        let pieces = pattern.map(|(lightness, keyframes)| {
            seen(&keyframes.map(|k| (k, lightness + light[k])).collect::<Vec<_>>())
        });
        let paints = paints_of(&pieces);
        assert!((paints[0].x - paints[1].x).abs() < 2.5, "{paints:?}");
        assert!((paints[1].x - paints[2].x).abs() < 2.5, "{paints:?}");
        assert!((paints[0].x - paints[3].x - 30.0).abs() < 2.5, "{paints:?}");
        assert!(paints.iter().all(|p| (p.z - 5.0).abs() < 1e-9));
    }

    #[test]
    fn what_keyframes_disagree_about_is_no_pattern() {
        // A shadow passes over a plain face: each keyframe shows it on other pieces.
        let shadowed = |i: usize, k: usize| if (i + k).is_multiple_of(4) { 40.0 } else { 80.0 };
        let shown =
            |i: usize| -> Vec<(usize, f64)> { (i % 2..4).map(|k| (k, shadowed(i, k))).collect() };
        let pieces: Vec<_> = (0..40).map(|i| seen(&shown(i))).collect();
        let raw: Vec<f64> = (0..40)
            .map(|i| shown(i).iter().map(|s| s.1).sum::<f64>() / shown(i).len() as f64)
            .collect();
        let spread = |values: Vec<f64>| {
            let of = |f: fn(f64, f64) -> f64| values.iter().copied().reduce(f).unwrap();
            of(f64::max) - of(f64::min)
        };
        let filtered = spread(paints_of(&pieces).iter().map(|p| p.x).collect());
        assert!(filtered < 0.3 * spread(raw.clone()), "{filtered} of {}", spread(raw));
    }
}
