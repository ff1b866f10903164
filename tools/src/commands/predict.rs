//! `linkage predict`.

use crate::cli::{Common, PredictArgs};
use crate::console::say;
use crate::outcome::{BAD_INPUT, Failure, NO_ANSWER, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, Asked, describe};
use crate::source;
use crate::steps::{
    PREDICTION, READING_FRAMES, READING_STORE, RECOGNITION, recognise_view, skill_config,
};
use linkage_driver::RgbdFrame;
use linkage_driver::live::host_utime;
use linkage_lcm::Lcm;
use linkage_planner_bridge::messages::Stamps;
use linkage_planner_bridge::{
    Plan, PlanError, Prediction, Request, Rig, channel, messages, predict,
};
use linkage_skill::ObjectModel;
use linkage_skill::learn::StageTimes;
use linkage_skill::predict::{PredictError, Target};
use linkage_skill::recognise::Recognition;
use linkage_skill::store::Store;

pub fn run(args: &PredictArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let target: Target = args.to.parse()?;
    let rig = match &args.rig {
        Some(path) => Rig::read(path)?,
        None => Rig::default(),
    };
    let store = Store::open(&args.store)?;
    let mut times = StageTimes::default();
    let library = times.measure(READING_STORE, || store.load())?;
    let mut source = source::open(&args.source, &args.take)?;
    let still = times.measure(READING_FRAMES, || source.still_frames())?;
    let recognised =
        times.measure(RECOGNITION, || recognise_view(&library, &still, &args.source, &config));
    let (frame, recognition) = recognised?;
    let Some(best) = recognition.matches.first() else {
        if let Some(path) = &args.report {
            let min_score = config.recognise.min_score;
            let (known, times) = (library.len(), &times);
            let asked = Asked { known, min_score, objects: &[], times };
            write_text(path, &report::recognition_page(&frame, &recognition, &asked)?)?;
        }
        return Err(Failure::no_answer(format!("{}: nothing is recognised", args.source)));
    };
    let object = store.get(&best.object)?;
    let model = &object.model;
    let request = Request { joint: args.joint.as_deref(), ..Request::to(target) };
    let plan = times.measure(PREDICTION, || predict(model, best, &request, &rig));
    if let Some(path) = &args.report {
        let why = plan.as_ref().map_err(ToString::to_string);
        let predicted = why.as_ref().map(|p| &p.prediction).map_err(String::as_str);
        write_text(path, &report::prediction_page(&frame, best, &object, predicted, &times)?)?;
    }
    let plan = plan.map_err(|e| {
        let unseen = matches!(e, PlanError::Predict(PredictError::Unseen { .. }));
        Failure { status: if unseen { NO_ANSWER } else { BAD_INPUT }, cause: e.into() }
    })?;
    let prediction = &plan.prediction;
    if let Some(path) = &args.json {
        write_json(path, prediction)?;
    }
    if let Some(url) = &args.publish {
        let url = if url.is_empty() { &rig.lcm_url } else { url };
        publish(&Lcm::new(url)?, &frame, &recognition, &plan, model)?;
    }
    if !common.quiet {
        say(describe(best).trim_end());
        say_motion(prediction);
    }
    Ok(())
}

/// Tells from where to where each joint goes.
fn say_motion(prediction: &Prediction) {
    for j in &prediction.joints {
        if let (Some(a), Some(b)) = (j.trajectory.first(), j.trajectory.last()) {
            say(format!(
                "{}/{}: {:.3} to {:.3} {} in {:.2} s",
                prediction.object,
                j.state.name,
                a[1],
                b[1],
                j.state.kind.unit(),
                b[0]
            ));
        }
    }
}

/// Sends model, recognition, prediction and plan; refuses where nothing would arrive.
pub fn publish(
    lcm: &Lcm,
    frame: &RgbdFrame,
    recognition: &Recognition,
    plan: &Plan,
    model: &ObjectModel,
) -> Outcome {
    if lcm.url().starts_with("udpm") {
        lcm.self_test(std::time::Duration::from_secs(2))?;
    }
    let utime = frame.utime;
    let stamps = Stamps { captured: utime, made: host_utime() };
    let robot_plan = messages::robot_plan(plan, stamps)?;
    let model_of = |name: &str| (name == model.object).then_some(model);
    lcm.publish(channel::MODEL, &messages::model(model, utime))?;
    lcm.publish(channel::RECOGNITION, &messages::recognition(recognition, model_of, utime))?;
    lcm.publish(channel::PREDICTION, &messages::prediction(&plan.prediction, model, stamps))?;
    lcm.publish(channel::PLAN, &robot_plan)?;
    Ok(())
}
