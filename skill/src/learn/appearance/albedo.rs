//! Separates the albedo of a surface from its shading. A plain door that turns reflects more or less light from frame
//! to frame. If colours were only averaged, a piece of the door that is seen only in early frames would become
//! brighter than the piece beside it, and the door would look textured.
//!
//! The colour of a piece in a keyframe is its albedo plus the shading of its face in that keyframe. What still
//! differs between the keyframes (shadows, highlights, pose errors) is noise; differences between neighbouring pieces
//! that it explains are removed, so that recognition does not search for them.
//!
//! In: colours of pieces of surface in each keyframe, CIELAB.
//! Out: the albedo of each piece, CIELAB.
//! From: alternating least squares; Wiener filter.

use nalgebra::Vector3;
use std::collections::HashMap;

/// Rounds of alternating least squares; a third round changes lightness by less than one unit.
const ROUNDS: usize = 3;

/// Colour of a piece of surface in one keyframe: CIELAB, summed over its pixels.
#[derive(Debug, Clone, Copy)]
pub struct SeenColour {
    /// Index of the keyframe.
    pub keyframe: usize,
    sum: Vector3<f64>,
    count: f64,
}

impl SeenColour {
    /// The colour of a first pixel.
    pub fn new(keyframe: usize, lab: Vector3<f64>) -> Self {
        Self { keyframe, sum: lab, count: 1.0 }
    }

    /// Adds one more pixel.
    pub fn add(&mut self, lab: Vector3<f64>) {
        self.sum += lab;
        self.count += 1.0;
    }
}

/// Part and main direction of the normal; pieces of one face share one shading.
pub type Face = (u16, u8);

/// A piece of surface.
#[derive(Debug, Clone, Copy)]
pub struct Piece<'c> {
    /// Face of the piece.
    pub face: Face,
    /// Cell of the piece; pieces of one face and one cell are compared with each other.
    pub neighbourhood: [i32; 3],
    /// Colour of the piece in each keyframe that shows it.
    pub seen: &'c [SeenColour],
}

/// The albedo of each piece of surface, CIELAB.
pub fn albedos(pieces: &[Piece]) -> Vec<Vector3<f64>> {
    let (mut albedos, shading) = albedos_and_shading(pieces);
    let mut neighbours: HashMap<(Face, [i32; 3]), Vec<usize>> = HashMap::new();
    for (i, piece) in pieces.iter().enumerate() {
        neighbours.entry((piece.face, piece.neighbourhood)).or_default().push(i);
    }
    for members in neighbours.values() {
        remove_noise(pieces, members, &shading, &mut albedos);
    }
    albedos
}

/// Shading by face and keyframe, CIELAB.
type Shading = HashMap<(Face, usize), Vector3<f64>>;

fn albedos_and_shading(pieces: &[Piece]) -> (Vec<Vector3<f64>>, Shading) {
    let mut shading = Shading::new();
    let mut albedos = albedos_under(pieces, &shading);
    for _ in 0..ROUNDS {
        let mut left: HashMap<(Face, usize), (Vector3<f64>, f64)> = HashMap::new();
        for (piece, albedo) in pieces.iter().zip(&albedos) {
            for colour in piece.seen {
                let entry = left.entry((piece.face, colour.keyframe)).or_default();
                entry.0 += colour.sum - albedo * colour.count;
                entry.1 += colour.count;
            }
        }
        shading = left.into_iter().map(|(key, (sum, count))| (key, sum / count)).collect();
        albedos = albedos_under(pieces, &shading);
    }
    (albedos, shading)
}

impl Piece<'_> {
    /// Colours of the piece without the shading, each with its number of pixels.
    fn unshaded<'a>(
        &'a self,
        shading: &'a Shading,
    ) -> impl Iterator<Item = (Vector3<f64>, f64)> + 'a {
        self.seen.iter().map(|c| {
            let shade = shading.get(&(self.face, c.keyframe)).copied().unwrap_or_default();
            (c.sum / c.count - shade, c.count)
        })
    }
}

/// The least-squares albedos for a fixed shading.
fn albedos_under(pieces: &[Piece], shading: &Shading) -> Vec<Vector3<f64>> {
    let albedo = |piece: &Piece| {
        let (sum, count) = piece
            .unshaded(shading)
            .fold((Vector3::zeros(), 0.0), |(s, n), (c, count)| (s + c * count, n + count));
        sum / count
    };
    pieces.iter().map(albedo).collect()
}

/// Removes from the albedos of neighbouring pieces the differences that noise between the keyframes explains (Wiener
/// filter).
fn remove_noise(
    pieces: &[Piece],
    members: &[usize],
    shading: &Shading,
    albedos: &mut [Vector3<f64>],
) {
    let n = members.len() as f64;
    let mean = members.iter().map(|&i| albedos[i]).sum::<Vector3<f64>>() / n;
    let between = members.iter().map(|&i| (albedos[i] - mean).norm_squared()).sum::<f64>() / n;
    let disagreement = |&i: &usize| {
        let squares = pieces[i].unshaded(shading).map(|(c, _)| (c - albedos[i]).norm_squared());
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
        albedos[i] = mean + (albedos[i] - mean) * kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(colours: &[(usize, f64)]) -> Vec<SeenColour> {
        let lit = |&(k, l): &(usize, f64)| SeenColour::new(k, Vector3::new(l, 0.0, 5.0));
        colours.iter().map(lit).collect()
    }

    fn albedos_of(seen: &[Vec<SeenColour>]) -> Vec<Vector3<f64>> {
        let piece = |seen| Piece { face: (1, 4), neighbourhood: [0; 3], seen };
        albedos(&seen.iter().map(|s| piece(&s[..])).collect::<Vec<_>>())
    }

    #[test]
    fn changing_light_adds_no_texture_to_a_plain_face_and_keeps_a_pattern() {
        let light = [0.0, -10.0, -20.0, -30.0];
        // Pieces: their lightness, and the keyframes that show them.
        let pattern = [(80.0, 0..4), (80.0, 0..2), (80.0, 2..4), (50.0, 1..4)];
        let pieces = pattern.map(|(lightness, keyframes)| {
            seen(&keyframes.map(|k| (k, lightness + light[k])).collect::<Vec<_>>())
        });
        let albedos = albedos_of(&pieces);
        assert!((albedos[0].x - albedos[1].x).abs() < 2.5, "{albedos:?}");
        assert!((albedos[1].x - albedos[2].x).abs() < 2.5, "{albedos:?}");
        assert!((albedos[0].x - albedos[3].x - 30.0).abs() < 2.5, "{albedos:?}");
        assert!(albedos.iter().all(|p| (p.z - 5.0).abs() < 1e-9));
    }

    #[test]
    fn a_difference_that_the_keyframes_do_not_share_is_no_pattern() {
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
        let filtered = spread(albedos_of(&pieces).iter().map(|p| p.x).collect());
        assert!(filtered < 0.3 * spread(raw.clone()), "{filtered} of {}", spread(raw));
    }
}
