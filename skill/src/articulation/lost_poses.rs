//! Finds the samples at which a tracker was lost: it writes some pose, often the same each time,
//! and later continues at the true pose.
//!
//! In space such samples may look like motion (a static object and one other position make a
//! slide). In time they do not: the object would jump there and back within single samples.

use super::pose_sample::PoseSample;
use crate::math::robust::median;
use std::collections::HashMap;

/// Share of samples that must follow one another without a jump. What remains may be lost.
const MIN_KEPT: f64 = 0.65;
/// A lost pose is this many standard deviations of a position away from the samples around it.
const FAR_SIGMAS: f64 = 10.0;
/// A thing may move this many times as fast as it does most of the time.
const MAX_SPEED_RATIO: f64 = 3.0;
/// Samples that are all compared with the one behind them; of earlier ones ever fewer are.
const ALL_BEFORE: usize = 32;

/// Marks the samples that no motion leads to. `sigma_m` is a position's standard deviation.
pub fn lost_samples(samples: &[PoseSample], sigma_m: f64) -> Vec<bool> {
    let none = vec![false; samples.len()];
    let far = FAR_SIGMAS * sigma_m;
    let step = |pair: &[PoseSample]| (pair[1].position - pair[0].position).norm();
    if samples.windows(2).all(|pair| step(pair) <= far) {
        return none;
    }
    let path = Path::new(samples);
    let Some(usual) = path.usual_step() else { return none };
    let reach = |gap: f64| 3.0 * sigma_m + MAX_SPEED_RATIO * usual * gap;
    let chain = path.longest_chain(&reach);
    let lost = path.unreachable(&chain, far, &reach);
    let count = lost.iter().filter(|l| **l).count();
    if count as f64 > (1.0 - MIN_KEPT) * samples.len() as f64 { none } else { lost }
}

struct Path<'s> {
    samples: &'s [PoseSample],
    /// Median time between samples.
    period: f64,
    /// By sample: its position is repeated bit by bit, while others are not. No chain begins or
    /// continues there.
    repeated: Vec<bool>,
    /// By sample: the first and the last of the consecutive samples that are at its very place.
    stays: Vec<(usize, usize)>,
}

impl<'s> Path<'s> {
    fn new(samples: &'s [PoseSample]) -> Self {
        let mut periods: Vec<f64> = samples.windows(2).map(|p| p[1].t - p[0].t).collect();
        let period = median(&mut periods).unwrap_or(1.0).max(1e-9);
        Self { samples, period, repeated: repeated(samples), stays: stays(samples) }
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        (self.samples[a].position - self.samples[b].position).norm()
    }

    /// Sample periods between two samples, at least the difference of their numbers.
    fn gap(&self, a: usize, b: usize) -> f64 {
        let periods = (self.samples[a].t - self.samples[b].t).abs() / self.period;
        periods.max(a.abs_diff(b) as f64)
    }

    fn is_reached(&self, a: usize, b: usize, reach: &impl Fn(f64) -> f64) -> bool {
        self.distance(a, b) <= reach(self.gap(a, b))
    }

    /// The least step a period with which most samples follow one another.
    fn usual_step(&self) -> Option<f64> {
        let needed = (MIN_KEPT * self.samples.len() as f64).ceil() as usize;
        let largest = (1..self.samples.len()).map(|i| self.distance(i - 1, i)).fold(0.0, f64::max);
        let suffices = |step: f64| self.longest_chain(&|gap| step * gap).len() >= needed;
        let (mut low, mut high) = (1e-4_f64.min(largest), largest);
        if largest <= 0.0 || !suffices(high) {
            return None;
        }
        while high > 1.2 * low {
            let middle = (low * high).sqrt();
            if suffices(middle) { high = middle } else { low = middle }
        }
        Some(high)
    }

    /// The most samples of which each is reached from the one before.
    fn longest_chain(&self, reach: &impl Fn(f64) -> f64) -> Vec<usize> {
        let n = self.samples.len();
        let mut length = vec![1_usize; n];
        let mut before = vec![None; n];
        for i in (0..n).filter(|&i| !self.repeated[i]) {
            let mut back = 1;
            while back <= i {
                let j = i - back;
                if !self.repeated[j] && length[j] >= length[i] && self.is_reached(i, j, reach) {
                    length[i] = length[j] + 1;
                    before[i] = Some(j);
                }
                back += 1 + back.saturating_sub(ALL_BEFORE) / 8;
            }
        }
        let mut chain = Vec::new();
        let mut at = (0..n).filter(|&i| !self.repeated[i]).max_by_key(|&i| length[i]);
        while let Some(i) = at {
            chain.push(i);
            at = before[i];
        }
        chain.reverse();
        chain
    }

    /// Samples between those of the chain that cannot be reached from their neighbours in it.
    fn unreachable(&self, chain: &[usize], far: f64, reach: &impl Fn(f64) -> f64) -> Vec<bool> {
        let n = self.samples.len();
        let mut lost = vec![false; n];
        let (Some(&first), Some(&last)) = (chain.first(), chain.last()) else { return lost };
        // A thing that stays where it is has come there within the time before its stay.
        let is_away = |i: usize, from: usize| {
            let (begin, end) = self.stays[i];
            let gap = if from < i { self.gap(begin, from) } else { self.gap(end, from) };
            self.distance(i, from) > far.max(reach(gap))
        };
        for pair in chain.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let run: Vec<usize> = (a + 1..b).filter(|&i| is_away(i, a) && is_away(i, b)).collect();
            if !self.is_on_the_path(&run, a) {
                run.iter().for_each(|&i| lost[i] = true);
            }
        }
        // Before and after the chain the object need not return: only samples that show no motion
        // of their own are lost there.
        for (run, from) in [(0..first, first), (last + 1..n, last)] {
            let away: Vec<usize> = run.clone().filter(|&i| is_away(i, from)).collect();
            if self.is_on_the_path(&away, from) {
                continue;
            }
            for i in away {
                let moves_on = |j: usize| {
                    run.contains(&j)
                        && self.is_reached(i, j, reach)
                        && self.samples[i].position != self.samples[j].position
                };
                lost[i] = !(moves_on(i + 1) || i > 0 && moves_on(i - 1));
            }
        }
        lost
    }

    /// True where samples of a run lie on the path from `a` to the middle of the run: a motion with
    /// few samples.
    fn is_on_the_path(&self, run: &[usize], a: usize) -> bool {
        let Some(&middle) = run.get(run.len() / 2) else { return false };
        let whole = self.distance(a, middle);
        let is_between = |&&i: &&usize| {
            let (there, on) = (self.distance(a, i), self.distance(i, middle));
            there.min(on) > 0.1 * whole && there + on < 1.05 * whole
        };
        run.iter().any(|i| is_between(&i))
    }
}

/// Marks positions that occur at least three times bit by bit, if few samples have them: measured
/// positions never repeat exactly, but the placeholder that a program writes for a missing pose
/// does.
fn repeated(samples: &[PoseSample]) -> Vec<bool> {
    let bits = |s: &PoseSample| s.position.coords.data.0[0].map(f64::to_bits);
    let mut counts: HashMap<[u64; 3], usize> = HashMap::new();
    for sample in samples {
        *counts.entry(bits(sample)).or_default() += 1;
    }
    let marks: Vec<bool> = samples.iter().map(|s| counts[&bits(s)] >= 3).collect();
    let count = marks.iter().filter(|m| **m).count() as f64;
    let few = count <= (1.0 - MIN_KEPT) * samples.len() as f64;
    if few { marks } else { vec![false; samples.len()] }
}

fn stays(samples: &[PoseSample]) -> Vec<(usize, usize)> {
    let groups = samples.chunk_by(|a, b| a.position == b.position);
    let mut begin = 0;
    groups
        .flat_map(|group| {
            let stay = (begin, begin + group.len() - 1);
            begin += group.len();
            std::iter::repeat_n(stay, group.len())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn samples(xs: impl IntoIterator<Item = f64>) -> Vec<PoseSample> {
        let sample = |(i, x): (usize, f64)| PoseSample {
            t: i as f64,
            position: Point3::new(x, 0.001 * (i as f64 * 7.7).sin(), 1.0),
            orientation: None,
        };
        xs.into_iter().enumerate().map(sample).collect()
    }

    fn lost(samples: &[PoseSample]) -> Vec<usize> {
        let marks = lost_samples(samples, 0.008);
        (0..marks.len()).filter(|&i| marks[i]).collect()
    }

    #[test]
    fn jumps_away_and_back_are_lost_and_nothing_else() {
        let mut drawer = samples((0..40).map(|i| 0.01 * f64::from(i)));
        assert!(lost(&drawer).is_empty());
        for i in [0, 7, 8, 9, 20, 39] {
            drawer[i].position = Point3::origin();
        }
        assert_eq!(lost(&drawer), [0, 7, 8, 9, 20, 39]);
    }

    #[test]
    fn a_fast_motion_that_is_seldom_sampled_is_not_lost() {
        // At rest, within two samples to 0.4 m, there for five, and back.
        let rest = [0.0; 25];
        let away = [0.14, 0.28, 0.4, 0.4, 0.4, 0.4, 0.4, 0.27, 0.13];
        assert!(lost(&samples(rest.into_iter().chain(away).chain(rest))).is_empty());
        // From rest to rest, once.
        let open = [0.1, 0.2, 0.3, 0.4, 0.4, 0.4, 0.4];
        assert!(lost(&samples(rest.into_iter().chain(open))).is_empty());
    }
}
