//! Growth: from the window in which a joint was suspected to all of the recording. The
//! joint's tracks give its configuration frame by frame; the configuration shows which other
//! tracks follow it.

use super::bundle_adjustment::{locate_points, refine};
use super::config::JointSearchConfig;
use super::configuration_vote::agree;
use super::estimate::{JointEstimate, TrackCost};
use super::helical_pitch;
use super::motion_hypotheses::Hypothesis;
use super::screw_joint::ScrewJoint;
use super::tracks_in_part_frame::TracksInFrame;
use super::verification;
use crate::math::rigid::{distance_to_line, screw_of};
use nalgebra::{Point3, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Cost an observation above which a window's fit is not worth growing.
const MAX_WINDOW_COST: f64 = 5.0;
/// Least turn of a window's motion that can show a hinge, radians.
const MIN_SCREW_ANGLE: f64 = 0.03;
/// Farthest hinge from the tracks that it moves, metres.
const MAX_LEVER: f64 = 2.0;
/// Frames without agreement after which growth ends.
pub const MAX_LOST: usize = 12;
/// Frames between refinements while growing,
const REFINE_EVERY: usize = 8;
/// and at least this part of those that are known.
const REFINE_SHARE: usize = 6;
/// Tracks that a refinement uses while growing.
const REFINE_TRACKS: usize = 80;
/// Tracks that carry a joint through the recording, besides those that it was suspected of.
const SWEEPERS: usize = 200;
/// Share of its tracks' observations that a joint leaves from which it will not be one.
pub const HOPELESSLY_UNRULY: f64 = 0.5;
/// Rounds of refinement when growth has ended.
const GROWTH_ROUNDS: usize = 3;
/// The same where the joint was certain already.
const RENEWAL_ROUNDS: usize = 1;
/// Tracks that the last refinements use.
const FINISH_TRACKS: usize = 150;
/// Tracks that the very last one uses,
const POLISH_TRACKS: usize = 300;
/// and frames.
const POLISH_FRAMES: usize = 120;
/// Tracks that are asked for a frame's configuration when growth has ended.
const VOTERS: usize = 100;
/// Share of a track's observations that a joint must explain to be asked about it again.
const HOPELESS_SHARE: f64 = 0.3;
/// Frames that they use: neighbours say the same.
pub const FINISH_FRAMES: usize = 60;
/// Factor on the cut within which tracks are asked whether they advance.
const FAR: f64 = 16.0;
/// Times that they are asked, the axis refined in between.
const PITCH_ROUNDS: usize = 3;
/// A hinge must gain this much more than a slide: a large circle imitates any line.
const HINGE_ADVANTAGE: f64 = 1.03;

/// The better of slide and hinge grown from a hypothesis; one that `is_hopeless` is not refined
/// in the end.
pub fn grow_hypothesis(
    view: &TracksInFrame,
    hypothesis: &Hypothesis,
    candidates: &[usize],
    config: &JointSearchConfig,
    is_hopeless: impl Fn(&JointEstimate) -> bool,
) -> Option<JointEstimate> {
    let mut best: Option<JointEstimate> = None;
    for (start, cost) in window_fits(view, hypothesis, config) {
        if cost > MAX_WINDOW_COST {
            continue;
        }
        let sweepers = sweepers(&hypothesis.tracks, candidates);
        let mut grown = swept(view, start, &sweepers, config);
        let mut rounds = if is_hopeless(&grown) { 0 } else { GROWTH_ROUNDS };
        if rounds > 0 && sweepers.len() < candidates.len() {
            finish(view, &mut grown, &sweepers, config, 1);
            if is_poor(view, &grown, config) {
                rounds = 0;
            }
        }
        finish(view, &mut grown, candidates, config, rounds);
        if grown.members.len() < 4 {
            continue;
        }
        let factor = match &best {
            None => 0.0,
            Some(_) if grown.dof.hinge => HINGE_ADVANTAGE,
            Some(_) => 1.0 / HINGE_ADVANTAGE,
        };
        if best.as_ref().is_none_or(|b| grown.gain > factor * b.gain) {
            best = Some(grown);
        }
    }
    best.map(|joint| with_pitch(view, joint, candidates, config))
}

/// Tracks that carry a joint through the recording: those that it was suspected of, and enough of
/// the others.
fn sweepers(suspected: &[usize], candidates: &[usize]) -> Vec<usize> {
    let mut some = some_of(candidates.to_vec(), SWEEPERS);
    some.extend(suspected);
    some.sort_unstable();
    some.dedup();
    some
}

/// It fits so poorly that more tracks cannot make a joint of it.
fn is_poor(view: &TracksInFrame, grown: &JointEstimate, config: &JointSearchConfig) -> bool {
    grown.members.len() >= 4
        && (grown.cost > 1.2 * verification::most_tolerated(config)
            || grown.unruly_share(view) > HOPELESSLY_UNRULY)
}

/// A joint that advances as it turns, grown on as the screw that it is: as a hinge it loses what
/// has advanced.
fn with_pitch(
    view: &TracksInFrame,
    grown: JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> JointEstimate {
    if !config.screws || !helical_pitch::can_be_told(&grown) {
        return grown;
    }
    // What a hinge keeps has hardly advanced: those that it lost are asked, too.
    let mut screw = grown.clone();
    let followers = gather(view, &mut screw, &mut candidates.to_vec(), FAR * config.cut);
    let followers: Vec<usize> = followers.into_iter().map(|m| m.track).collect();
    let some = some_of(followers.clone(), FINISH_TRACKS);
    let Some(axis) = helical_pitch::turning_axis(&screw, view, &followers) else { return grown };
    screw.dof.axis = axis;
    for _ in 0..PITCH_ROUNDS {
        screw.dof.pitch = helical_pitch::pitch_of(&screw, view, &followers);
        if screw.dof.pitch == grown.dof.pitch {
            return grown;
        }
        refine(&mut screw, view, &some, FAR * config.cut, config.finish_steps);
    }
    let screw = carried_on(view, screw, candidates, config, GROWTH_ROUNDS);
    if screw.gain > grown.gain { screw } else { grown }
}

/// Slide and hinge fitted to the window alone, with their cost an observation.
fn window_fits(
    view: &TracksInFrame,
    h: &Hypothesis,
    config: &JointSearchConfig,
) -> Vec<(JointEstimate, f64)> {
    let at = |t: usize, f: usize| view.at(t, f).map(|s| s.point.coords);
    let n = h.tracks.len() as f64;
    let start: Vector3<f64> =
        h.tracks.iter().filter_map(|&t| at(t, h.from)).sum::<Vector3<f64>>() / n;
    let end: Vector3<f64> = h.tracks.iter().filter_map(|&t| at(t, h.to)).sum::<Vector3<f64>>() / n;
    let centre = Point3::from(start);
    let mut fits = Vec::new();
    if let Some(axis) = (end - start).try_normalize(1e-6) {
        fits.push(window_fit(view, ScrewJoint::slide(axis, centre), h, config));
    }
    if let Some(screw) = screw_of(&h.motion)
        && screw.angle > MIN_SCREW_ANGLE
        && distance_to_line(&screw.origin, &screw.axis, &centre) < MAX_LEVER
    {
        let dof = ScrewJoint::hinge(screw.axis.into_inner(), screw.origin);
        let hinge = window_fit(view, dof, h, config);
        let slide_cost = fits.first().map_or(f64::INFINITY, |(_, c)| *c);
        if slide_cost > 1.3 * hinge.1 + 0.2 {
            fits.clear();
        }
        if hinge.1 < 0.95 * slide_cost {
            fits.push(hinge);
        }
    }
    fits
}

fn window_fit(
    view: &TracksInFrame,
    dof: ScrewJoint,
    h: &Hypothesis,
    config: &JointSearchConfig,
) -> (JointEstimate, f64) {
    let mut joint = JointEstimate::new(dof, view, h.from);
    for &t in &h.tracks {
        if let Some(s) = view.at(t, h.from) {
            joint.points[t] = s.point;
        }
    }
    let mut q = 0.0;
    for f in h.from..=h.to {
        let alive: Vec<usize> =
            h.tracks.iter().copied().filter(|&t| view.at(t, f).is_some()).collect();
        if alive.len() < 3 || !view.usable[f] {
            continue;
        }
        let ones = vec![1.0; alive.len()];
        let agreement = agree(&joint, view, &alive, &ones, f, Some(q), 2.0 * config.cut);
        q = agreement.q;
        if agreement.agreeing >= 3 {
            joint.q[f] = q;
            joint.known[f] = true;
        }
    }
    joint.members = h.tracks.clone();
    refine(&mut joint, view, &h.tracks, config.cut, 6);
    let (mut sum, mut observations) = (0.0, 0);
    let motions = joint.motions();
    for &t in &h.tracks {
        let cost = joint.cost_of(&motions, view, t, config.cut);
        sum += cost.sum;
        observations += cost.observations;
    }
    (joint, sum / observations.max(1) as f64)
}

/// What is known of each track while a joint grows.
struct TrackScores {
    known: Vec<bool>,
    hits: Vec<usize>,
    misses: Vec<usize>,
    low: Vec<f64>,
    high: Vec<f64>,
}

impl TrackScores {
    fn new(view: &TracksInFrame, joint: &JointEstimate, cut: f64) -> Self {
        let n = view.len();
        let mut book = Self {
            known: vec![false; n],
            hits: vec![0; n],
            misses: vec![0; n],
            low: vec![f64::INFINITY; n],
            high: vec![f64::NEG_INFINITY; n],
        };
        let motions = joint.motions();
        for &t in &joint.members {
            book.known[t] = true;
            let cost = joint.cost_of(&motions, view, t, cut);
            book.hits[t] = cost.inliers;
            book.misses[t] = cost.observations - cost.inliers;
            for (f, _) in view.life(t).filter(|(f, _)| joint.known[*f]) {
                book.saw(t, joint.q[f]);
            }
        }
        book
    }

    fn saw(&mut self, t: usize, q: f64) {
        self.low[t] = self.low[t].min(q);
        self.high[t] = self.high[t].max(q);
    }

    /// Right four times, mostly right, and moved by a centimetre.
    fn trusted(&self, joint: &JointEstimate, t: usize) -> bool {
        self.right(t) && (self.high[t] - self.low[t]) * joint.dof.lever(&joint.points[t]) > 0.01
    }

    fn right(&self, t: usize) -> bool {
        self.hits[t] >= 4 && self.hits[t] > 3 * self.misses[t]
    }

    fn weight(&self, trusted: bool, t: usize) -> f64 {
        if trusted {
            1.0
        } else if self.right(t) {
            0.15
        } else if self.hits[t] + self.misses[t] < 4 {
            0.1
        } else {
            0.02
        }
    }

    /// New tracks get their part point from the frame that they are first seen in.
    fn admit_new_tracks(
        &mut self,
        view: &TracksInFrame,
        joint: &mut JointEstimate,
        candidates: &[usize],
        f: usize,
        q: f64,
    ) {
        for &t in candidates {
            if let (false, Some(s)) = (self.known[t], view.at(t, f)) {
                joint.points[t] = joint.dof.move_point(-q, &s.point);
                self.known[t] = true;
                self.saw(t, q);
            }
        }
    }
}

/// Carries a joint to all frames, from those in which it is known; `was_certain`: those told its
/// line so well that a few more frames hardly move it.
pub fn grow(
    view: &TracksInFrame,
    joint: JointEstimate,
    was_certain: bool,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> JointEstimate {
    let rounds = if was_certain { RENEWAL_ROUNDS } else { GROWTH_ROUNDS };
    let joint = carried_on(view, joint, candidates, config, rounds);
    with_pitch(view, joint, candidates, config)
}

/// The same as the kind of joint that it is taken for.
fn carried_on(
    view: &TracksInFrame,
    joint: JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
    rounds: usize,
) -> JointEstimate {
    let mut joint = swept(view, joint, candidates, config);
    finish(view, &mut joint, candidates, config, rounds);
    joint
}

/// The same, not yet refined.
fn swept(
    view: &TracksInFrame,
    mut joint: JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
) -> JointEstimate {
    let known = joint.known_frames();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return joint };
    let mut book = TrackScores::new(view, &joint, config.cut);
    let mut rng = ChaCha8Rng::seed_from_u64(first as u64);
    sweep(view, &mut joint, &mut book, candidates, config, &mut rng, first..view.frames);
    sweep(view, &mut joint, &mut book, candidates, config, &mut rng, (0..last + 1).rev());
    joint
}

fn sweep(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    book: &mut TrackScores,
    candidates: &[usize],
    config: &JointSearchConfig,
    rng: &mut ChaCha8Rng,
    frames: impl Iterator<Item = usize>,
) {
    let mut q = 0.0;
    let (mut lost, mut grown) = (0, 0);
    for f in frames {
        if !view.usable[f] {
            continue;
        }
        if joint.known[f] {
            q = joint.q[f];
            lost = 0;
            book.admit_new_tracks(view, joint, candidates, f, q);
            continue;
        }
        match next_configuration(view, joint, book, candidates, config, f, q) {
            Some(found) => {
                q = found;
                lost = 0;
                joint.q[f] = q;
                joint.known[f] = true;
                book.admit_new_tracks(view, joint, candidates, f, q);
            }
            None => lost += 1,
        }
        if lost > MAX_LOST {
            return;
        }
        grown += 1;
        // The more is known, the less a few frames add.
        if grown >= REFINE_EVERY.max(joint.known_frames().len() / REFINE_SHARE) {
            grown = 0;
            refine_while_growing(view, joint, book, candidates, config, rng, f);
            if let Some(near) = joint.known_frames().into_iter().min_by_key(|k| k.abs_diff(f)) {
                q = joint.q[near];
            }
        }
    }
}

fn next_configuration(
    view: &TracksInFrame,
    joint: &JointEstimate,
    book: &mut TrackScores,
    candidates: &[usize],
    config: &JointSearchConfig,
    f: usize,
    guess: f64,
) -> Option<f64> {
    let alive: Vec<usize> =
        candidates.iter().copied().filter(|&t| book.known[t] && view.at(t, f).is_some()).collect();
    if alive.is_empty() {
        return None;
    }
    let trusted: Vec<bool> = alive.iter().map(|&t| book.trusted(joint, t)).collect();
    let weights: Vec<f64> =
        alive.iter().zip(&trusted).map(|(&t, &trusted)| book.weight(trusted, t)).collect();
    let cut = 2.0 * config.cut;
    let q = agree(joint, view, &alive, &weights, f, Some(guess), cut).q;
    let agrees: Vec<bool> = alive
        .iter()
        .map(|&t| {
            view.at(t, f)
                .is_some_and(|s| s.distance_sq(&joint.dof.move_point(q, &joint.points[t])) < cut)
        })
        .collect();
    let trusted_count = trusted.iter().filter(|t| **t).count();
    let trusted_agreeing = trusted.iter().zip(&agrees).filter(|(t, a)| **t && **a).count();
    let agreeing = agrees.iter().filter(|a| **a).count();
    let weight_agreeing: f64 =
        weights.iter().zip(&agrees).filter(|(_, a)| **a).map(|(w, _)| w).sum();
    let good = (trusted_agreeing >= 3 && trusted_agreeing as f64 >= 0.35 * trusted_count as f64)
        || (trusted_agreeing >= 2 && trusted_count <= 3)
        || (trusted_count < 3
            && agreeing >= 5
            && weight_agreeing >= 0.6 * weights.iter().sum::<f64>());
    if !good {
        return None;
    }
    for (&t, &agrees) in alive.iter().zip(&agrees) {
        if agrees {
            book.hits[t] += 1;
        } else {
            book.misses[t] += 1;
        }
        book.saw(t, q);
    }
    Some(q)
}

fn refine_while_growing(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    book: &TrackScores,
    candidates: &[usize],
    config: &JointSearchConfig,
    rng: &mut ChaCha8Rng,
    frame: usize,
) {
    let known: Vec<usize> = candidates.iter().copied().filter(|&t| book.known[t]).collect();
    let mut trusted: Vec<usize> =
        known.iter().copied().filter(|&t| book.trusted(joint, t)).collect();
    if trusted.len() < 4 {
        return;
    }
    if trusted.len() > REFINE_TRACKS {
        trusted.shuffle(rng);
        trusted.truncate(REFINE_TRACKS);
    }
    refine(joint, view, &trusted, config.cut, config.growth_steps);
    let alive: Vec<usize> = known.into_iter().filter(|&t| view.at(t, frame).is_some()).collect();
    locate_points(joint, view, &alive, 4.0 * config.cut);
}

/// A track that follows a joint: its cost if it stood still, its cost, and its observations.
struct Follower {
    track: usize,
    still: f64,
    cost: f64,
    observations: usize,
}

/// Tracks that follow the joint: seen often enough, mostly right, better off than standing
/// still, and moved by more than a centimetre. Candidates that hardly ever do are dropped.
fn gather(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    candidates: &mut Vec<usize>,
    cut: f64,
) -> Vec<Follower> {
    locate_points(joint, view, candidates, 2.0 * cut);
    let motions = joint.motions();
    let judged: Vec<(bool, Option<Follower>)> = candidates
        .par_iter()
        .map(|&track| {
            let cost = joint.cost_of(&motions, view, track, cut);
            let right = cost.inliers as f64 / cost.observations.max(1) as f64;
            let is_right = cost.observations >= 5 && right > 0.7;
            let follower = is_right.then(|| follower(view, joint, track, &cost, cut)).flatten();
            (cost.observations < 5 || right > HOPELESS_SHARE, follower)
        })
        .collect();
    let mut hopeful = judged.iter().map(|(hopeful, _)| *hopeful);
    candidates.retain(|_| hopeful.next().unwrap_or(true));
    judged.into_iter().filter_map(|(_, follower)| follower).collect()
}

fn follower(
    view: &TracksInFrame,
    joint: &JointEstimate,
    track: usize,
    cost: &TrackCost,
    cut: f64,
) -> Option<Follower> {
    let still = view.static_cost(track, &joint.known, cut);
    let follows = still - cost.sum > 2.0 * cut && joint.travel(view, track) > 0.012;
    follows.then_some(Follower { track, still, cost: cost.sum, observations: cost.observations })
}

/// Gathers members, refines on them, recomputes every frame's configuration; `rounds` times.
pub fn finish(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    candidates: &[usize],
    config: &JointSearchConfig,
    rounds: usize,
) {
    let mut rng = ChaCha8Rng::seed_from_u64(candidates.len() as u64);
    let mut candidates = candidates.to_vec();
    for round in 0..rounds {
        let cut = if round == 0 { 2.0 * config.cut } else { config.cut };
        let members: Vec<usize> =
            gather(view, joint, &mut candidates, cut).into_iter().map(|m| m.track).collect();
        if members.len() < 4 {
            break;
        }
        let mut some = members.clone();
        if some.len() > FINISH_TRACKS {
            some.shuffle(&mut rng);
            some.truncate(FINISH_TRACKS);
            some.sort_unstable();
        }
        let known = std::mem::take(&mut joint.known);
        joint.known = thinned(&known, joint.anchor, FINISH_FRAMES);
        refine(joint, view, &some, config.cut, config.finish_steps);
        locate_points(joint, view, &members, config.cut);
        joint.known = known;
        configure_all(view, joint, &members, config.cut, VOTERS);
    }
    let followers = gather(view, joint, &mut candidates, config.cut);
    let gain: f64 = followers.iter().map(|m| m.still - m.cost).sum();
    let cost: f64 = followers.iter().map(|m| m.cost).sum();
    let observations: usize = followers.iter().map(|m| m.observations).sum();
    let known = joint.known.iter().filter(|k| **k).count();
    joint.gain = gain / 5.0 - config.frame_penalty * (known + 5) as f64;
    joint.cost = cost / observations.max(1) as f64;
    joint.members = followers.into_iter().map(|m| m.track).collect();
    joint.summarise();
}

/// Refines a joint on more of its members in more frames than while it grew.
pub fn polish(
    view: &TracksInFrame,
    mut joint: JointEstimate,
    config: &JointSearchConfig,
) -> JointEstimate {
    let members = joint.members.clone();
    let some = some_of(members.clone(), POLISH_TRACKS);
    let known = joint.known.clone();
    joint.known = thinned(&known, joint.anchor, POLISH_FRAMES);
    refine(&mut joint, view, &some, config.cut, config.finish_steps);
    joint.known = known;
    locate_points(&mut joint, view, &members, config.cut);
    configure_all(view, &mut joint, &members, config.cut, POLISH_TRACKS);
    joint.summarise();
    joint
}

/// At most about `most` of them, evenly spread.
fn some_of(all: Vec<usize>, most: usize) -> Vec<usize> {
    let stride = all.len().div_ceil(most).max(1);
    all.into_iter().step_by(stride).collect()
}

/// At most so many of the known frames, evenly spread, and the anchor.
pub fn thinned(known: &[bool], anchor: usize, most: usize) -> Vec<bool> {
    let stride = known.iter().filter(|k| **k).count().div_ceil(most).max(1);
    let mut before = 0;
    let mut kept = |(f, &known): (usize, &bool)| {
        before += usize::from(known);
        known && (before % stride == 1 % stride || f == anchor)
    };
    known.iter().enumerate().map(&mut kept).collect()
}

fn configure_all(
    view: &TracksInFrame,
    joint: &mut JointEstimate,
    members: &[usize],
    cut: f64,
    voters: usize,
) {
    let configured: Vec<Option<f64>> = (0..view.frames)
        .into_par_iter()
        .map(|f| configuration(view, joint, members, cut, voters, f))
        .collect();
    for (f, configuration) in configured.into_iter().enumerate() {
        joint.known[f] = configuration.is_some();
        joint.q[f] = configuration.unwrap_or(joint.q[f]);
    }
}

/// The configuration of a frame that enough members agree on.
fn configuration(
    view: &TracksInFrame,
    joint: &JointEstimate,
    members: &[usize],
    cut: f64,
    voters: usize,
    frame: usize,
) -> Option<f64> {
    if !view.usable[frame] || joint.contradicted.contains(&frame) {
        return None;
    }
    let guess = joint.known[frame].then_some(joint.q[frame]);
    let alive: Vec<usize> =
        members.iter().copied().filter(|&t| view.at(t, frame).is_some()).collect();
    match alive.len() {
        0 | 1 => return None,
        2 => return guess,
        _ => {}
    }
    let alive = some_of(alive, voters);
    let ones = vec![1.0; alive.len()];
    let agreement = agree(joint, view, &alive, &ones, frame, guess, cut);
    let enough = agreement.agreeing as f64 >= (0.4 * alive.len() as f64).max(3.0);
    enough.then_some(agreement.q)
}
