//! Rigid motion between two sets of points of which many are wrong (outliers).

use super::rigid::{Pose, rigid_fit};
use nalgebra::Point3;
use rand::Rng;

/// A pair of corresponding points with the standard deviation (metres) expected of their
/// distance, and a weight for sampling and scoring.
#[derive(Debug, Clone, Copy)]
pub struct Correspondence {
    /// Before the motion.
    pub from: Point3<f64>,
    /// After it.
    pub to: Point3<f64>,
    /// Expected standard deviation of the residual, metres.
    pub sigma: f64,
    /// Weight, above zero.
    pub weight: f64,
}

/// How [`ransac_rigid`] searches.
#[derive(Debug, Clone, Copy)]
pub struct RansacOptions {
    /// Residual, in multiples of sigma, at which a pair stops counting.
    pub cut: f64,
    /// Samples drawn.
    pub iterations: usize,
    /// Second and third point are drawn within this distance of the first, in metres.
    pub locality: Option<f64>,
}

/// A rigid motion and the pairs that follow it.
#[derive(Debug, Clone)]
pub struct RigidMotion {
    /// `to_from_from`: takes `from` to `to`.
    pub motion: Pose,
    /// Indices of the pairs within the cut.
    pub inliers: Vec<usize>,
}

/// The rigid motion that most pairs follow: MSAC over three-point samples, then reweighted
/// closed-form fits over the inliers. `guess` is scored first.
pub fn ransac_rigid(
    pairs: &[Correspondence],
    options: &RansacOptions,
    guess: Option<&Pose>,
    rng: &mut impl Rng,
) -> Option<RigidMotion> {
    if pairs.len() < 3 {
        return None;
    }
    let mut best = (0.0, None);
    let mut consider = |motion: Pose| {
        let score = msac_score(pairs, &motion, options.cut);
        if score > best.0 {
            best = (score, Some(motion));
        }
    };
    if let Some(guess) = guess {
        consider(*guess);
    }
    let cumulative: Vec<f64> = pairs
        .iter()
        .scan(0.0, |sum, p| {
            *sum += p.weight;
            Some(*sum)
        })
        .collect();
    for _ in 0..options.iterations {
        if let Some(motion) =
            draw_triple(pairs, &cumulative, options, rng).and_then(|t| fit_triple(pairs, t))
        {
            consider(motion);
        }
    }
    let mut motion = best.1?;
    for _ in 0..3 {
        motion = reweighted_fit(pairs, &motion, options.cut).unwrap_or(motion);
    }
    let inliers: Vec<usize> = (0..pairs.len())
        .filter(|&i| residual_ratio_sq(&pairs[i], &motion, options.cut) < 1.0)
        .collect();
    (inliers.len() >= 3).then_some(RigidMotion { motion, inliers })
}

fn residual_ratio_sq(pair: &Correspondence, motion: &Pose, cut: f64) -> f64 {
    (motion * pair.from - pair.to).norm_squared() / (cut * pair.sigma).powi(2)
}

fn msac_score(pairs: &[Correspondence], motion: &Pose, cut: f64) -> f64 {
    pairs.iter().map(|p| p.weight * (1.0 - residual_ratio_sq(p, motion, cut)).max(0.0)).sum()
}

fn reweighted_fit(pairs: &[Correspondence], motion: &Pose, cut: f64) -> Option<Pose> {
    let (mut from, mut to, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    for pair in pairs {
        let closeness = 1.0 - residual_ratio_sq(pair, motion, cut);
        if closeness > 0.0 {
            from.push(pair.from);
            to.push(pair.to);
            weights.push(pair.weight * (closeness / pair.sigma).powi(2));
        }
    }
    rigid_fit(&from, &to, &weights)
}

fn draw_triple(
    pairs: &[Correspondence],
    cumulative: &[f64],
    options: &RansacOptions,
    rng: &mut impl Rng,
) -> Option<[usize; 3]> {
    let total = *cumulative.last()?;
    let mut draw = || {
        let x = rng.random::<f64>() * total;
        cumulative.partition_point(|&c| c < x).min(pairs.len() - 1)
    };
    let first = draw();
    let mut triple = [first; 3];
    let mut filled = 1;
    for _ in 0..60 {
        let next = draw();
        let near =
            options.locality.is_none_or(|r| (pairs[next].from - pairs[first].from).norm() <= r);
        if near && !triple[..filled].contains(&next) {
            triple[filled] = next;
            filled += 1;
            if filled == 3 {
                let consistent = [(0, 1), (1, 2), (2, 0)].iter().all(|&(i, j)| {
                    let (p, q) = (&pairs[triple[i]], &pairs[triple[j]]);
                    let stretch = (p.from - q.from).norm() - (p.to - q.to).norm();
                    stretch.abs() <= options.cut * p.sigma.max(q.sigma)
                });
                return consistent.then_some(triple);
            }
        }
    }
    None
}

fn fit_triple(pairs: &[Correspondence], triple: [usize; 3]) -> Option<Pose> {
    rigid_fit(&triple.map(|i| pairs[i].from), &triple.map(|i| pairs[i].to), &[1.0; 3])
}

#[cfg(test)]
mod tests {
    use super::super::rigid::tests::{any_pose, cloud};
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;

    proptest! {
        #[test]
        fn ransac_survives_a_third_of_outliers(pose in any_pose(), seed in 0_u64..50) {
            let pairs: Vec<_> = cloud().iter().enumerate().map(|(i, p)| Correspondence {
                from: *p,
                to: if i % 3 == 0 { Point3::new(i as f64, -1.0, 0.3) } else { pose * p },
                sigma: 0.005,
                weight: 1.0,
            }).collect();
            let options = RansacOptions { cut: 2.0, iterations: 200, locality: None };
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let found = ransac_rigid(&pairs, &options, None, &mut rng).unwrap();
            prop_assert!((found.motion.translation.vector - pose.translation.vector).norm() < 1e-6);
            prop_assert!(found.inliers.len() >= 13);
        }
    }
}
