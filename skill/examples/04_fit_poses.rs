//! Fits joints to a log of poses that something else has tracked, such as a marker on a door.
//!
//! ```sh
//! cargo run --release -p linkage-skill --example 04_fit_poses -- door.log
//! cargo run --release -p linkage-skill --example 04_fit_poses -- door.log t,x,y,z,_,_
//! ```
//!
//! In: a log, a line a pose, and what its columns hold where neither their names nor their number
//! tell it. Out: each type of joint with its probability, least BIC first; the line of the best one
//! in the log's frame. Metres and radians.

use linkage_skill::articulation::{
    Columns, PoseLogError, fit_models, read_pose_log, type_probabilities,
};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let Err(error) = run() else { return ExitCode::SUCCESS };
    eprintln!("{error}");
    ExitCode::FAILURE
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (path, columns) = match arguments.as_slice() {
        [path] => (path, None),
        [path, names] => (path, Some(names.parse::<Columns>()?)),
        _ => return Err("usage: 04_fit_poses LOG [COLUMNS]".into()),
    };
    let log = read_pose_log(Path::new(path), columns.as_ref())?;
    let fits = fit_models(&log.samples).map_err(|source| {
        // The error of a fit knows no file.
        PoseLogError::Fit { path: path.clone(), source, lost: log.describe_lost() }
    })?;
    println!("{} poses", log.samples.len());
    if let Some(lost) = log.describe_lost() {
        println!("{lost}");
    }

    let probabilities = type_probabilities(&fits);
    for fit in &fits {
        let kind = fit.geometry.kind;
        let probability = probabilities.get(&kind).copied().unwrap_or_default();
        let rmse_mm = 1000.0 * fit.position_rmse;
        println!(
            "{}: probability {probability:.3}, BIC {:.1}, rmse {rmse_mm:.1} mm",
            kind.name(),
            fit.bic
        );
    }
    let best = fits.first().ok_or_else(|| format!("{path}: no joint explains it"))?;
    let (axis, origin) = (best.geometry.axis, best.geometry.origin);
    let told = best.configuration.iter().zip(&best.inlier).filter(|(_, inlier)| **inlier);
    let (low, high) = told.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (q, _)| {
        (low.min(*q), high.max(*q))
    });
    println!("axis ({:.3}, {:.3}, {:.3})", axis.x, axis.y, axis.z);
    println!("through ({:.3}, {:.3}, {:.3}) m", origin.x, origin.y, origin.z);
    println!("seen from {low:.3} to {high:.3} {}", best.geometry.kind.unit());
    Ok(())
}
