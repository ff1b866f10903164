//! Poses that a tracker lost do not change what is fitted: however far away, however many up to
//! 30 %, each elsewhere or all at one place.

use linkage_skill::articulation::{FittedJoint, PoseSample, fit_models};
use linkage_skill::object::{JointGeometry, JointKind};
use nalgebra::{Point3, Quaternion, UnitQuaternion, UnitVector3, Vector3};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How the outliers of a log look.
#[derive(Debug, Clone, Copy)]
enum Outliers {
    /// All are one pose, as `0 0 0 0 0 0 1`.
    Identical,
    /// Each is elsewhere.
    Scattered,
    /// One pose, in as few runs as possible.
    Runs,
    /// Each has the orientation that it had, and is moved by one vector, off the joint's path. Not used for fixed
    /// things: two positions look like a slide.
    Shifted,
}

#[derive(Debug, Clone)]
struct Log {
    kind: JointKind,
    has_orientation: bool,
    samples: usize,
    share: f64,
    /// Least distance from the thing's path, metres.
    distance: f64,
    outliers: Outliers,
    seed: u64,
}

fn log() -> impl Strategy<Value = Log> {
    let kind =
        prop_oneof![Just(JointKind::Fixed), Just(JointKind::Prismatic), Just(JointKind::Revolute)];
    let outliers = prop_oneof![
        Just(Outliers::Identical),
        Just(Outliers::Scattered),
        Just(Outliers::Runs),
        Just(Outliers::Shifted)
    ];
    let numbers = (30_usize..120, 0.0..0.3_f64, -1.0..3.0_f64);
    (kind, any::<bool>(), numbers, outliers, any::<u64>()).prop_map(
        |(kind, has_orientation, (samples, share, exponent), mut outliers, seed)| {
            if let (JointKind::Fixed, Outliers::Shifted) = (kind, outliers) {
                outliers = Outliers::Identical;
            }
            Log {
                kind,
                has_orientation,
                samples,
                share,
                distance: 10_f64.powf(exponent),
                outliers,
                seed,
            }
        },
    )
}

fn direction(random: &mut ChaCha8Rng) -> UnitVector3<f64> {
    loop {
        let v = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        if v.norm() > 0.1 && v.norm() < 1.0 {
            return UnitVector3::new_normalize(v);
        }
    }
}

/// A thing that is opened, from rest to rest, and its joint.
fn clean(log: &Log, random: &mut ChaCha8Rng) -> (Vec<PoseSample>, JointGeometry) {
    let axis = direction(random);
    let rest = Point3::from(direction(random).into_inner() * 1.2);
    let out = axis.cross(&direction(random)).normalize();
    let geometry = match log.kind {
        JointKind::Revolute => JointGeometry::hinge(axis, rest + out * 0.7),
        _ => JointGeometry::slide(axis, rest),
    };
    let span = match log.kind {
        JointKind::Fixed => 0.0,
        JointKind::Prismatic => 0.35,
        _ => 1.1,
    };
    let turned = UnitQuaternion::from_scaled_axis(direction(random).into_inner() * 0.8);
    let last = log.samples as f64 - 1.0;
    let samples = (0..log.samples)
        .map(|i| {
            let x = i as f64 / last;
            let motion = geometry.motion(span * x * x * (3.0 - 2.0 * x));
            let noise = direction(random).into_inner() * 0.0015;
            let tilt = UnitQuaternion::from_scaled_axis(direction(random).into_inner() * 0.005);
            PoseSample {
                t: i as f64 / 15.0,
                position: motion * rest + noise,
                orientation: log.has_orientation.then(|| tilt * motion.rotation * turned),
            }
        })
        .collect();
    (samples, geometry)
}

/// Least distance of a point from where a joint can take another one, metres.
fn distance_from_path(joint: &JointGeometry, rest: &Point3<f64>, p: &Point3<f64>) -> f64 {
    let along_and_across = |p: &Point3<f64>| {
        let d = p - joint.origin;
        let along = joint.axis.dot(&d);
        (along, (d - joint.axis.into_inner() * along).norm())
    };
    let (rest_along, rest_across) = along_and_across(rest);
    let (along, across) = along_and_across(p);
    match joint.kind {
        JointKind::Revolute => (along - rest_along).hypot(across - rest_across),
        _ => across,
    }
}

/// Replaces some samples; true for those.
fn spoil(
    log: &Log,
    joint: &JointGeometry,
    samples: &mut [PoseSample],
    random: &mut ChaCha8Rng,
) -> Vec<bool> {
    let n = samples.len();
    let count = (log.share * n as f64) as usize;
    let mut is_outlier = vec![false; n];
    let path: Vec<Point3<f64>> = samples.iter().map(|s| s.position).collect();
    let far_away = |random: &mut ChaCha8Rng| loop {
        let from = path[random.random_range(0..n)];
        let to =
            from + direction(random).into_inner() * log.distance * random.random_range(1.0..1.5);
        if path.iter().all(|p| (p - to).norm() >= log.distance) {
            return to;
        }
    };
    let same = far_away(random);
    let shift = loop {
        let shift = direction(random).into_inner() * log.distance;
        let is_off = |p: &Point3<f64>| {
            distance_from_path(joint, &path[0], &(p + shift)) >= log.distance / 2.0
        };
        if path.iter().all(is_off) {
            break shift;
        }
    };
    let mut next = random.random_range(0..n);
    for _ in 0..count {
        while is_outlier[next] {
            next = match log.outliers {
                Outliers::Runs => (next + 1) % n,
                _ => random.random_range(0..n),
            };
        }
        is_outlier[next] = true;
        samples[next].position = match log.outliers {
            Outliers::Scattered => far_away(random),
            Outliers::Shifted => path[next] + shift,
            _ => same,
        };
        if log.has_orientation && !matches!(log.outliers, Outliers::Shifted) {
            samples[next].orientation = Some(match log.outliers {
                Outliers::Scattered => UnitQuaternion::from_quaternion(Quaternion::new(
                    random.random_range(-1.0..1.0),
                    random.random_range(-1.0..1.0),
                    random.random_range(-1.0..1.0),
                    random.random_range(0.1..1.0),
                )),
                _ => UnitQuaternion::identity(),
            });
        }
    }
    is_outlier
}

fn span(joint: &FittedJoint) -> f64 {
    let known: Vec<f64> = (0..joint.inlier.len())
        .filter(|&i| joint.inlier[i])
        .map(|i| joint.configuration[i])
        .collect();
    let extreme = |f: fn(f64, f64) -> f64| known.iter().copied().reduce(f).unwrap_or(0.0);
    extreme(f64::max) - extreme(f64::min)
}

fn assert_alike(log: &Log) -> Result<(), TestCaseError> {
    let mut random = ChaCha8Rng::seed_from_u64(log.seed);
    let (mut samples, joint) = clean(log, &mut random);
    let mut without = samples.clone();
    let is_outlier = spoil(log, &joint, &mut samples, &mut random);
    let mut outliers = is_outlier.iter();
    without.retain(|_| !*outliers.next().unwrap());
    let expected = fit_models(&without).unwrap().swap_remove(0);
    let found = fit_models(&samples).unwrap().swap_remove(0);
    prop_assert_eq!(expected.geometry.kind, log.kind);
    prop_assert_eq!(found.geometry.kind, log.kind);
    let expected_inlier: Vec<bool> = is_outlier.iter().map(|is| !is).collect();
    prop_assert_eq!(&found.inlier, &expected_inlier);
    prop_assert!((span(&found) - span(&expected)).abs() < 0.01);
    prop_assert!((found.position_rmse - expected.position_rmse).abs() < 0.0005);
    if log.kind != JointKind::Fixed {
        let off = found.geometry.axis.dot(&expected.geometry.axis).abs().min(1.0).acos();
        prop_assert!(off < 0.01, "axis off by {} rad", off);
    }
    if log.kind == JointKind::Revolute {
        let off = (found.geometry.origin - expected.geometry.origin).norm();
        prop_assert!(off < 0.01, "hinge off by {} m", off);
    }
    Ok(())
}

/// Logs that are tried, the same each time.
const LOGS: usize = 1000;

#[test]
fn lost_poses_change_nothing_of_what_is_fitted() {
    let random = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let mut runner = TestRunner::new_with_rng(ProptestConfig::default(), random);
    let logs = log();
    let misjudged: Vec<String> = (0..LOGS)
        .map(|_| logs.new_tree(&mut runner).expect("a log").current())
        .filter_map(|log| Some(format!("{log:?}: {}", assert_alike(&log).err()?)))
        .collect();
    assert!(misjudged.is_empty(), "{} of {LOGS} are misjudged: {misjudged:#?}", misjudged.len());
}

#[test]
fn a_position_that_jumps_while_the_orientation_is_right_does_not_bend_a_hinge() {
    // If the angle came from such a position, the correct orientation would seem slightly wrong, and bend the hinge.
    let log = Log {
        kind: JointKind::Revolute,
        has_orientation: true,
        samples: 30,
        share: 0.3,
        distance: 0.0,
        outliers: Outliers::Shifted,
        seed: 0,
    };
    for seed in 0..20 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (mut samples, joint) = clean(&log, &mut random);
        let [out, across] =
            [(samples[0].position - joint.origin).normalize(), joint.axis.into_inner()];
        let shift = 0.2 * out - 0.1 * across.cross(&out) + 0.15 * across;
        let chosen = rand::seq::index::sample(&mut random, 28, 9);
        chosen.iter().for_each(|i| samples[1 + i].position += shift);
        let found = fit_models(&samples).unwrap().swap_remove(0);
        let off = (joint.origin - found.geometry.origin).cross(&found.geometry.axis).norm();
        assert!(off < 0.01, "seed {seed}: the hinge is off by {off} m");
    }
}
