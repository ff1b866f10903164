//! `linkage fit`: articulation models from pose logs.

use super::{Outcome, skill_config, write_json};
use crate::cli::{Common, FitArgs};
use linkage_skill::SkillConfig;
use linkage_skill::articulate::{
    FittedJoint, PoseLogError, PoseSample, fit_models, read_pose_log, type_probabilities,
};
use linkage_skill::model::{
    Joint, MODEL_SCHEMA, ObjectModel, Part, ReferenceFrame, covariance_rows, is_undecided,
};
use linkage_skill::structure::{orient, range_of};
use std::path::Path;

pub fn run(args: &FitArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let models = args
        .logs
        .iter()
        .map(|log| fit(log, &config))
        .collect::<Result<Vec<ObjectModel>, PoseLogError>>()?;
    if !common.quiet {
        for (log, model) in args.logs.iter().zip(&models) {
            let j = &model.joints[0];
            eprintln!(
                "{}: {} {:.3} to {:.3} {}, rmse {:.1} mm",
                log.display(),
                j.kind.name(),
                j.range[0],
                j.range[1],
                j.kind.unit(),
                1000.0 * j.position_rmse
            );
        }
    }
    match (&args.json, models.as_slice()) {
        (Some(path), [one]) => write_json(path, one),
        (Some(path), many) => write_json(path, &many),
        (None, _) => Ok(()),
    }
}

fn fit(log: &Path, config: &SkillConfig) -> Result<ObjectModel, PoseLogError> {
    let samples = read_pose_log(log)?;
    let fits = fit_models(&samples, &config.articulate)
        .map_err(|source| PoseLogError::Fit { path: log.display().to_string(), source })?;
    let name = log.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    Ok(to_model(&name, &samples, &fits, config))
}

/// One object a log: the log's frame is the object's, the log's thing its only part.
fn to_model(
    name: &str,
    samples: &[PoseSample],
    fits: &[FittedJoint],
    config: &SkillConfig,
) -> ObjectModel {
    let best = &fits[0];
    let mut geometry = best.geometry;
    let mut configuration = best.configuration.clone();
    orient(&mut geometry, &mut configuration);
    let probabilities = type_probabilities(fits);
    let joint = Joint {
        range: range_of(&configuration),
        covariance: covariance_rows(&best.covariance),
        observations: samples.len(),
        bic: best.bic,
        log_likelihood: best.log_likelihood,
        position_rmse: best.position_rmse,
        orientation_rmse: best.orientation_rmse,
        configuration: samples.iter().zip(&configuration).map(|(s, &q)| [s.t, q]).collect(),
        undecided: is_undecided(&probabilities),
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
