//! Separates parts that form one surface while they rest, such as the doors and drawers of one front, by the
//! time at which they move. Depth images see through the place of a part while it is away, and between the
//! motions of two parts all of them rest.
//!
//! In: for each sample of a surface, the keyframes that see through its place. Out: the number of the episode
//! (the motion of one part) of each sample.
//!
//! Two parts that are away at the same time are not separated. Neither are parts of which one moves between
//! two motions of the other: when a board tilts about its middle, one half moves in front of its rest
//! position and the other half behind it, and images see through the place of the first half before and after
//! they see through the place of the second.

/// Set of the tested keyframes that see something behind a place: one bit for each, in the order of time.
pub type AwayKeyframes = u64;

/// Smallest share of a surface's samples that are away in a keyframe of an episode.
const LEAST_AWAY: f64 = 0.05;
/// Smallest number of tested keyframes without motion between two episodes.
const FEWEST_BETWEEN: usize = 2;
/// Largest share of the samples that may be away in both of two episodes; above it, one part moved twice.
const MOST_IN_BOTH: f64 = 0.1;

/// The episode of each sample, from 0; 0 for all samples if the episodes do not follow one another.
pub fn episodes(away: &[AwayKeyframes]) -> Vec<usize> {
    let mut episodes = intervals(away);
    while let Some((a, b)) = pair_of_one_part(&episodes, away) {
        episodes[a] |= episodes[b];
        episodes.remove(b);
    }
    let follow_each_other = |w: &[AwayKeyframes]| w[0].ilog2() < w[1].trailing_zeros();
    if !episodes.windows(2).all(follow_each_other) {
        return vec![0; away.len()];
    }
    let of = |sample: &AwayKeyframes| {
        (0..episodes.len()).max_by_key(|e| (sample & episodes[*e]).count_ones()).unwrap_or(0)
    };
    away.iter().map(of).collect()
}

/// Intervals of time, as sets of keyframes, between which hardly any sample is away.
fn intervals(away: &[AwayKeyframes]) -> Vec<AwayKeyframes> {
    let least = (LEAST_AWAY * away.len() as f64).max(1.0);
    let is_away = |bit: usize| away.iter().filter(|a| *a >> bit & 1 == 1).count() as f64 >= least;
    let mut found: Vec<AwayKeyframes> = Vec::new();
    let mut rested = FEWEST_BETWEEN;
    for bit in 0..AwayKeyframes::BITS as usize {
        if !is_away(bit) {
            rested += 1;
            continue;
        }
        match found.last_mut() {
            Some(last) if rested < FEWEST_BETWEEN => *last |= 1 << bit,
            _ => found.push(1 << bit),
        }
        rested = 0;
    }
    found
}

/// Two episodes, the earlier first, in both of which many samples are away: they are motions of one part.
fn pair_of_one_part(episodes: &[AwayKeyframes], away: &[AwayKeyframes]) -> Option<(usize, usize)> {
    let in_both = |a: usize, b: usize| {
        away.iter().filter(|s| *s & episodes[a] != 0 && *s & episodes[b] != 0).count()
    };
    let most = MOST_IN_BOTH * away.len() as f64;
    let pairs = (0..episodes.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    pairs.into_iter().find(|(a, b)| in_both(*a, *b) as f64 > most)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As many samples as are asked for, away in some keyframes.
    fn samples(n: usize, away: std::ops::Range<u32>) -> Vec<AwayKeyframes> {
        vec![away.map(|bit| 1 << bit).sum(); n]
    }

    #[test]
    fn two_doors_of_one_front_that_open_one_after_the_other_are_two_episodes() {
        let mut away = samples(50, 3..9);
        away.extend(samples(30, 14..20));
        let found = episodes(&away);
        assert!(found[..50].iter().all(|e| *e == found[0]));
        assert!(found[50..].iter().all(|e| *e == found[50]));
        assert_ne!(found[0], found[50]);
    }

    #[test]
    fn a_door_that_opens_twice_is_one() {
        let twice = samples(50, 3..9)[0] | samples(1, 14..20)[0];
        // The side of the hinge leaves its place for a shorter time, once.
        let mut away = vec![twice; 50];
        away.extend(samples(20, 5..7));
        assert!(episodes(&away).iter().all(|e| *e == 0));
    }

    #[test]
    fn doors_that_are_open_at_the_same_time_are_not_told_apart() {
        let mut away = samples(50, 3..20);
        away.extend(samples(30, 10..20));
        assert!(episodes(&away).iter().all(|e| *e == 0));
    }

    #[test]
    fn the_two_halves_of_a_board_that_tilts_are_one() {
        // Tilted, the lower half is before where it rests at both ends of the recording, the upper one behind.
        let at_rest = samples(50, 0..6)[0] | samples(1, 18..24)[0];
        let mut away = vec![at_rest; 50];
        away.extend(samples(50, 9..12));
        assert!(episodes(&away).iter().all(|e| *e == 0));
    }

    #[test]
    fn a_single_keyframe_of_noise_is_no_episode() {
        let mut away = samples(50, 3..9);
        away[7] |= 1 << 30;
        assert!(episodes(&away).iter().all(|e| *e == 0));
        assert!(episodes(&[]).is_empty());
    }
}
