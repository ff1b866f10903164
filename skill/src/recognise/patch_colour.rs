//! Correlation of learned and seen colour within patches of surface.
//!
//! In: L*a*b* colours, by patch.
//! Out: a correlation of -1 to 1, and the amount of texture.
//! From: normalised cross-correlation: mean and scale of each patch are removed, because light differs between a
//! demonstration and an encounter, and texture does not.

use nalgebra::Vector3;

/// Standard deviation of the colour within a patch, L*a*b*, above which more variation gives no more weight.
const TELLING: f64 = 3.0;
/// Variance of colour due to noise, L*a*b* squared; keeps plain surfaces from correlating by chance.
const NOISE: f64 = 1.0;
/// Smallest number of surfels of a patch that is compared.
const LEAST_IN_PATCH: f64 = 12.0;
/// Smallest number of surfels, in patches that are compared, for a correlation.
const LEAST_IN_ALL: f64 = 25.0;

/// Sums of learned and seen colours over the surfels of a patch.
#[derive(Clone, Copy, Default)]
pub struct PatchColours {
    n: f64,
    learned: Vector3<f64>,
    seen: Vector3<f64>,
    learned_squared: f64,
    seen_squared: f64,
    common: f64,
}

impl PatchColours {
    /// Adds the learned and the seen colour of one surfel.
    pub fn add(&mut self, learned: [f32; 3], seen: [f32; 3]) {
        let [x, y] = [learned, seen].map(|lab| Vector3::from(lab).map(f64::from));
        self.n += 1.0;
        self.learned += x;
        self.seen += y;
        self.learned_squared += x.norm_squared();
        self.seen_squared += y.norm_squared();
        self.common += x.dot(&y);
    }

    /// Correlation of the patch, and its weight.
    fn correlation(&self) -> (f64, f64) {
        let (mx, my) = (self.learned / self.n, self.seen / self.n);
        let xx = (self.learned_squared / self.n - mx.norm_squared()).max(0.0);
        let yy = (self.seen_squared / self.n - my.norm_squared()).max(0.0);
        let xy = self.common / self.n - mx.dot(&my);
        let weight = self.n * xx.min(TELLING * TELLING) / TELLING;
        (xy / ((xx + NOISE) * (yy + NOISE)).sqrt(), weight)
    }
}

/// Mean correlation of colour within patches, -1 to 1, weighted by surface and texture; `None` with too little
/// surface or without texture. Each patch is normalised by itself, so that one patch of strong contrast does not
/// dominate.
pub fn correlation(patches: &[PatchColours]) -> Option<f64> {
    let (mut sum, mut total, mut count) = (0.0, 0.0, 0.0);
    for patch in patches.iter().filter(|patch| patch.n >= LEAST_IN_PATCH) {
        let (correlation, weight) = patch.correlation();
        sum += weight * correlation;
        total += weight;
        count += patch.n;
    }
    (count >= LEAST_IN_ALL && total > 0.0).then(|| sum / total)
}

/// Amount of texture of the learned colour within patches, 0 to 1.
pub fn texture(patches: &[PatchColours]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for patch in patches.iter().filter(|patch| patch.n >= LEAST_IN_PATCH) {
        sum += patch.correlation().1 / TELLING;
        count += patch.n;
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Correlation of patches with learned colours and seen ones, by number.
    fn likeness(learned: fn(usize) -> [f32; 3], seen: fn(usize) -> [f32; 3]) -> f64 {
        let mut patch = PatchColours::default();
        (0..40).for_each(|i| patch.add(learned(i), seen(i)));
        correlation(&[patch]).unwrap()
    }

    #[test]
    fn colours_vary_as_learned_or_otherwise_where_lightness_hardly_does() {
        let striped: fn(usize) -> [f32; 3] =
            |i| [60.0 + (i % 2) as f32, 20.0 * (i / 2 % 2) as f32, 0.0];
        let in_dim_light: fn(usize) -> [f32; 3] =
            |i| [30.0 + 0.5 * (i % 2) as f32, 5.0 + 10.0 * (i / 2 % 2) as f32, 3.0];
        let of_other_hue: fn(usize) -> [f32; 3] =
            |i| [60.0 + (i % 2) as f32, 0.0, 20.0 * (i / 3 % 2) as f32];
        assert!(likeness(striped, in_dim_light) > 0.9);
        assert!(likeness(striped, of_other_hue) < 0.1);
    }

    #[test]
    fn a_plain_patch_hardly_counts_beside_a_painted_one() {
        let mut patches = [PatchColours::default(); 2];
        for i in 0..40_usize {
            let painted = [20.0 * (i % 2) as f32, 0.0, 0.0];
            let noise = |period: usize| [(i / period % 2) as f32, 0.0, 0.0];
            patches[0].add(painted, painted);
            patches[1].add(noise(1), noise(2));
        }
        assert!(correlation(&patches).unwrap() > 0.9);
    }
}
