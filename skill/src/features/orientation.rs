//! The directions in which gradients about a place are strongest (Lowe 2004).

use std::f32::consts::TAU;

/// Directions that are counted, from right towards down.
pub const BINS: usize = 36;
/// Share of the strongest direction's strength that another must have to be one.
const NEARLY: f32 = 0.8;

/// Directions of one place.
const MOST: usize = 2;

/// Strength of gradients by direction.
pub type Histogram = [f32; BINS];

/// Peaks of a histogram, radians from right towards down, the strongest first; each is at the top
/// of a parabola.
#[inline(always)]
pub fn peaks(histogram: &Histogram) -> Vec<f32> {
    let smooth = smoothed(histogram);
    let least = NEARLY * smooth.iter().copied().fold(0.0, f32::max);
    let mut peaks: Vec<(f32, f32)> = (0..BINS)
        .filter_map(|i| {
            let [left, here, right] = [i + BINS - 1, i, i + 1].map(|i| smooth[i % BINS]);
            let is_peak = here > left && here >= right && here >= least;
            is_peak.then(|| {
                let top = 0.5 * (left - right) / (left - 2.0 * here + right);
                (here, (TAU / BINS as f32 * (i as f32 + top)).rem_euclid(TAU))
            })
        })
        .collect();
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.into_iter().take(MOST).map(|(_, angle)| angle).collect()
}

/// Each with its neighbours.
#[inline(always)]
fn smoothed(histogram: &Histogram) -> Histogram {
    let at = |i: usize, by: usize| histogram[(i + BINS + by - 2) % BINS];
    std::array::from_fn(|i| {
        (at(i, 0) + at(i, 4) + 4.0 * (at(i, 1) + at(i, 3)) + 6.0 * at(i, 2)) / 16.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(strengths: &[(usize, f32)]) -> Histogram {
        let mut histogram = [0.0; BINS];
        strengths.iter().for_each(|(bin, strength)| histogram[*bin] = *strength);
        histogram
    }

    #[test]
    fn the_strongest_direction_comes_first_and_weak_ones_not_at_all() {
        let found = peaks(&with(&[(9, 0.9), (18, 1.0), (30, 0.5)]));
        assert_eq!(found.len(), 2);
        assert!((found[0] - 0.5 * TAU).abs() < 1e-4 && (found[1] - 0.25 * TAU).abs() < 1e-4);
    }

    #[test]
    fn a_direction_may_lie_between_bins_and_across_the_last_one() {
        let found = peaks(&with(&[(BINS - 1, 1.0), (0, 1.0)]));
        let half_a_bin = 0.5 * TAU / BINS as f32;
        assert_eq!(found.len(), 1);
        assert!((found[0] - (TAU - half_a_bin)).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn where_nothing_changes_there_is_no_direction() {
        assert!(peaks(&with(&[])).is_empty());
    }
}
