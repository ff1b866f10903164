//! `linkage fit`: time per pose log. With `$LINKAGE_DATA` the real logs, each alone and all
//! of known type together; without, a synthetic door of 300 samples.

#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use linkage_skill::articulation::{PoseSample, fit_models, read_pose_log};
use nalgebra::Point3;
use std::hint::black_box;
use std::path::{Path, PathBuf};

fn synthetic_door() -> Vec<PoseSample> {
    (0..300)
        .map(|i| {
            let i = f64::from(i);
            let angle = 1.4 * i / 299.0;
            let noise = 0.002 * (i * 12.9898).sin();
            let radius = 0.4 + noise;
            let position = Point3::new(radius * angle.cos(), radius * angle.sin(), noise);
            PoseSample { t: i, position, orientation: None }
        })
        .collect()
}

fn logs_of_known_type() -> Vec<(String, Vec<PoseSample>)> {
    let data = std::env::var("LINKAGE_DATA").map_or_else(
        |_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let dir = data.join("pose_logs");
    let Ok(catalogue) = std::fs::read_to_string(dir.join("catalogue.csv")) else {
        return Vec::new();
    };
    catalogue
        .lines()
        .filter_map(|line| {
            let mut fields = line.split(',');
            let (file, kind) = (fields.next()?, fields.next()?);
            let known = kind == "revolute" || kind == "prismatic";
            known.then(|| (file.to_owned(), read_pose_log(&dir.join(file), None).ok()))
        })
        .filter_map(|(file, log)| Some((file, log?.samples)))
        .collect()
}

fn fit(c: &mut Criterion) {
    let door = synthetic_door();
    c.bench_function("fit/synthetic door, 300 samples", |b| {
        b.iter(|| fit_models(black_box(&door)));
    });
    let logs = logs_of_known_type();
    let mut medians: Vec<(f64, &str)> = logs
        .iter()
        .map(|(file, samples)| {
            let mut times: Vec<f64> = (0..9)
                .map(|_| {
                    let start = std::time::Instant::now();
                    let _ = black_box(fit_models(black_box(samples)));
                    start.elapsed().as_secs_f64() * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            (times[4], file.as_str())
        })
        .collect();
    medians.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let (Some(middle), Some(worst)) = (medians.get(medians.len() / 2), medians.last()) {
        println!(
            "real logs: {} of known type, median {:.2} ms a log, slowest {:.2} ms ({})",
            medians.len(),
            middle.0,
            worst.0,
            worst.1
        );
    }
}

criterion_group!(benches, fit);
criterion_main!(benches);
