//! `linkage fit`: articulation models from pose logs.

use crate::cli::{Common, FitArgs};
use crate::console::say;
use crate::outcome::Outcome;
use crate::output::write_json;
use crate::steps::skill_config;
use linkage_skill::SkillConfig;
use linkage_skill::articulation::{
    FittedJoint, PoseLog, PoseLogError, PoseSample, fit_models, read_pose_log, type_probabilities,
};
use linkage_skill::internals::{covariance_rows, is_undecided, orient, range_of};
use linkage_skill::object::{Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame};
use std::path::Path;

/// A log and what was fitted to it.
struct Fitted {
    log: PoseLog,
    outliers: usize,
    model: ObjectModel,
}

pub fn run(args: &FitArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let fitted = args
        .logs
        .iter()
        .map(|log| fit(log, args, &config))
        .collect::<Result<Vec<Fitted>, PoseLogError>>()?;
    if !common.quiet {
        for (path, fitted) in args.logs.iter().zip(&fitted) {
            say(format!("{}: {}", path.display(), summary(fitted)));
        }
    }
    let models: Vec<&ObjectModel> = fitted.iter().map(|f| &f.model).collect();
    match (&args.json, models.as_slice()) {
        (Some(path), [one]) => write_json(path, one),
        (Some(path), many) => write_json(path, &many),
        (None, _) => Ok(()),
    }
}

/// The joint and what was left out, for people.
fn summary(fitted: &Fitted) -> String {
    let j = &fitted.model.joints[0];
    let mut text = format!(
        "{} {:.3} to {:.3} {}, rmse {:.1} mm",
        j.kind.name(),
        j.range[0],
        j.range[1],
        j.kind.unit(),
        1000.0 * j.position_rmse
    );
    if fitted.outliers > 0 {
        let samples = fitted.log.samples.len();
        text += &format!("; {} of {samples} samples are outliers", fitted.outliers);
    }
    if let Some(lost) = fitted.log.describe_lost() {
        text += &format!("; {lost}");
    }
    text
}

fn fit(path: &Path, args: &FitArgs, config: &SkillConfig) -> Result<Fitted, PoseLogError> {
    let log = read_pose_log(path, args.columns.as_ref())?;
    let fits = fit_models(&log.samples).map_err(|source| {
        let lost = log.describe_lost();
        PoseLogError::Fit { path: path.display().to_string(), source, lost }
    })?;
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let outliers = fits[0].inlier.iter().filter(|inlier| !**inlier).count();
    let model = to_model(&name, &log.samples, &fits, config);
    Ok(Fitted { log, outliers, model })
}

/// One object a log: the log's frame is the object's, the log's thing its only part. Outliers
/// have no configuration.
fn to_model(
    name: &str,
    samples: &[PoseSample],
    fits: &[FittedJoint],
    config: &SkillConfig,
) -> ObjectModel {
    let best = &fits[0];
    let mut geometry = best.geometry;
    let told: Vec<usize> = (0..samples.len()).filter(|&i| best.inlier[i]).collect();
    let mut configuration: Vec<f64> = told.iter().map(|&i| best.configuration[i]).collect();
    orient(&mut geometry, &mut configuration);
    let probabilities = type_probabilities(fits);
    let joint = Joint {
        range: range_of(&configuration),
        covariance: covariance_rows(&best.covariance),
        observations: told.len(),
        bic: best.bic,
        log_likelihood: best.log_likelihood,
        position_rmse: best.position_rmse,
        orientation_rmse: best.orientation_rmse,
        configuration: told.iter().zip(&configuration).map(|(&i, &q)| [samples[i].t, q]).collect(),
        undecided: is_undecided(geometry.kind, &probabilities),
        type_probabilities: probabilities,
        ..Joint::of(&geometry)
    };
    let part = |id: usize, name: &str| Part::new(id, name, 0);
    ObjectModel {
        schema: MODEL_SCHEMA.to_owned(),
        object: name.to_owned(),
        reference_frame: ReferenceFrame::at_camera(samples[0].t),
        parts: vec![part(0, "base"), part(1, "part1")],
        joints: vec![joint],
        demonstrations: 1,
        profile: config.profile.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}
