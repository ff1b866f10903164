//! `linkage demo`: the whole pipeline once, on recordings that it simulates itself. A hand opens a
//! fridge; the fridge is learned, and recognised from another viewpoint with its door ajar. Its opening
//! is predicted and published to a subscriber that decodes it. One page shows all results.

use super::predict::publish;
use crate::cli::{Common, DemoArgs, SourceArgs};
use crate::console::{answer, say};
use crate::outcome::{Failure, Outcome};
use crate::output::{write_json, write_text};
use crate::report::{self, Asked, DemoPage, DetailLinks};
use crate::simulate::{Surfaces, Take};
use crate::source;
use crate::steps::{
    FilmOrder, PREDICTION, READING_FRAMES, READING_STORE, RECOGNITION, demonstrate, film,
    recognise_view, remember, skill_config,
};
use crate::truth::Truth;
use anyhow::{Context, anyhow};
use linkage_driver::{RgbdFrame, jpeg};
use linkage_lcm::messages::{drake, linkage};
use linkage_lcm::{Lcm, Message, Packet, decode};
use linkage_planner_bridge::{Request, Rig, channel, predict};
use linkage_skill::internals::{distance_to_line, line_angle};
use linkage_skill::learn::StageTimes;
use linkage_skill::object::StoredObject;
use linkage_skill::predict::Target;
use linkage_skill::recognise::{Recognised, Recognition};
use linkage_skill::store::Store;
use linkage_skill::{Demonstration, SkillConfig};
use nalgebra::{Point3, Vector3};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The object of the demonstration.
const SCENE: &str = "fridge";
/// A plain fridge in rooms as in homes.
const SURFACES: Surfaces = Surfaces::Plain;
/// Seeds of the two rooms.
const DEMONSTRATION_SEED: u64 = 1;
const ENCOUNTER_SEED: u64 = 7;

/// Name of the store in the output folder.
const STORE: &str = "objects.linkage";
/// Quality of the picture, of 100.
const PICTURE_QUALITY: u8 = 88;

pub fn run(args: &DemoArgs, common: &Common) -> Outcome {
    let config = skill_config(common)?;
    let out = &args.out;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let (watched, met) = (out.join("demonstration"), out.join("encounter"));
    step(common, "1/5 simulating a person opening a fridge");
    let order = |take, seed| FilmOrder { surfaces: SURFACES, ..FilmOrder::of(SCENE, take, seed) };
    film(&order(Take::Demonstration, DEMONSTRATION_SEED), &watched, common.quiet)?;
    film(&order(Take::Encounter, ENCOUNTER_SEED), &met, common.quiet)?;

    step(common, "2/5 learning from the demonstration");
    let (demonstration, stored) = learn(&watched, out, &config, common.quiet)?;

    step(common, "3/5 recognising it from another viewpoint");
    let mut times = StageTimes::default();
    let (frame, recognition) = recognise(&met, out, &stored, &config, &mut times)?;
    let best = recognition
        .matches
        .first()
        .ok_or_else(|| Failure::no_answer("the fridge was not recognised"))?;

    step(common, "4/5 predicting how it opens");
    let rig = Rig::default();
    let model = &demonstration.model;
    let request = Request::to(Target::Open);
    let plan = times.measure(PREDICTION, || predict(model, best, &request, &rig))?;
    write_json(&out.join("prediction.json"), &plan.prediction)?;
    let picture = out.join("prediction.png");
    report::save_prediction_picture(&frame, best, &plan.prediction, &stored, &picture)?;
    let page = report::prediction_page(&frame, best, &stored, Ok(&plan.prediction), &times)?;
    write_text(&out.join("prediction.html"), &page)?;

    step(common, "5/5 publishing over LCM");
    let mut listener = Lcm::new(&rig.lcm_url)?;
    listener.subscribe("LINKAGE_.*")?;
    publish(&Lcm::new(&rig.lcm_url)?, &frame, &recognition, &plan, model)?;
    let received = Received::listen(&mut listener)?;

    let right = errors(&watched, &met, &demonstration.model.joints[0], best)?;
    let proof: Vec<String> = right.lines().map(str::to_owned).chain([received.summary()]).collect();
    proof.iter().try_for_each(answer)?;
    let page = DemoPage {
        demonstration: &demonstration,
        object: &stored,
        frame: &frame,
        recognised: best,
        prediction: &plan.prediction,
    };
    let path = write_demo_page(&page, &proof, out)?;
    answer(format!("look at {}", path.display()))
}

/// Recognises in the frames of a recording with what was stored, and tells it in a page.
fn recognise(
    met: &Path,
    out: &Path,
    stored: &StoredObject,
    config: &SkillConfig,
    times: &mut StageTimes,
) -> Outcome<(RgbdFrame, Recognition)> {
    let source = met.display().to_string();
    let still = times.measure(READING_FRAMES, || {
        source::open(&source, &SourceArgs::default())?.still_frames()
    })?;
    let store = Store::open(&out.join(STORE))?;
    let library = times.measure(READING_STORE, || store.load())?;
    let (frame, recognition) =
        times.measure(RECOGNITION, || recognise_view(&library, &still, &source, config))?;
    write_json(&out.join("recognition.json"), &recognition)?;
    let (known, objects) = (library.len(), std::slice::from_ref(stored));
    let asked = Asked { known, min_score: config.recognise.min_score, objects, times };
    let page = report::recognition_page(&frame, &recognition, &asked)?;
    write_text(&out.join("recognition.html"), &page)?;
    Ok((frame, recognition))
}

/// Learns, stores what was learned, and tells it in pages and pictures.
fn learn(
    watched: &Path,
    out: &Path,
    config: &SkillConfig,
    quiet: bool,
) -> Outcome<(Demonstration, StoredObject)> {
    let source = watched.display().to_string();
    let demonstration = demonstrate(&source, SCENE, config, quiet)?;
    if demonstration.model.joints.is_empty() {
        return Err(Failure::no_answer("no joint was learned"));
    }
    let stored = remember(None, &demonstration, &source, config)?;
    Store::open_or_create(&out.join(STORE))?.put(&stored)?;
    write_json(&out.join("model.json"), &demonstration.model)?;
    let page = report::demonstration_page(&demonstration, Some(&stored.appearance))?;
    write_text(&out.join("report.html"), &page)?;
    report::save_demonstration_pictures(&demonstration, Some(&stored.appearance), out)?;
    Ok((demonstration, stored))
}

/// Writes the page of the whole demo and its picture; returns the path of the page.
fn write_demo_page(page: &DemoPage, proof: &[String], out: &Path) -> Outcome<PathBuf> {
    let links = DetailLinks {
        learned: "report.html",
        recognised: "recognition.html",
        predicted: "prediction.html",
    };
    let path = out.join("index.html");
    write_text(&path, &page.html(&links, proof)?)?;
    let picture = out.join("demo.jpg");
    let bytes = jpeg::encode(&page.picture()?, PICTURE_QUALITY).map_err(anyhow::Error::msg)?;
    std::fs::write(&picture, bytes).with_context(|| picture.display().to_string())?;
    Ok(path)
}

fn step(common: &Common, text: &str) {
    if !common.quiet {
        say(text);
    }
}

/// What the subscriber decoded.
struct Received {
    model: linkage::Model,
    prediction: linkage::Prediction,
    plan: drake::LcmtRobotPlan,
}

impl Received {
    fn listen(listener: &mut Lcm) -> anyhow::Result<Self> {
        let mut packets: Vec<Packet> = Vec::new();
        while let Some(packet) = listener.receive(Duration::from_secs(1))? {
            packets.push(packet);
            if packets.iter().any(|p| p.channel == channel::PLAN) {
                break;
            }
        }
        Ok(Self {
            model: of_channel(&packets, channel::MODEL)?,
            prediction: of_channel(&packets, channel::PREDICTION)?,
            plan: of_channel(&packets, channel::PLAN)?,
        })
    }

    fn summary(&self) -> String {
        let knots = self.plan.plan.len();
        let last = self.plan.plan.last();
        format!(
            "received over LCM: model of {} with {} joint(s), prediction with {} trajectory, plan of {knots} knots ending at {:.3} after {:.2} s",
            self.model.object,
            self.model.joints.len(),
            self.prediction.trajectories.len(),
            last.and_then(|s| s.joint_position.first()).copied().unwrap_or_default(),
            last.map_or(0.0, |s| s.utime as f64 * 1e-6),
        )
    }
}

fn of_channel<M: Message>(packets: &[Packet], channel: &str) -> anyhow::Result<M> {
    let packet = packets
        .iter()
        .find(|p| p.channel == channel)
        .ok_or_else(|| anyhow!("nothing was received on {channel}"))?;
    decode(&packet.bytes).with_context(|| channel.to_owned())
}

/// Errors against the simulator's truth.
fn errors(
    watched: &Path,
    met: &Path,
    joint: &linkage_skill::Joint,
    found: &Recognised,
) -> anyhow::Result<String> {
    let (demonstrated, encountered) = (Truth::read(watched)?, Truth::read(met)?);
    let (first, now) = (&demonstrated.joints[0], &encountered.joints[0]);
    let true_axis = Vector3::from(first.axis);
    let learned_deg = line_angle(&true_axis, &Vector3::from(joint.axis)).to_degrees();
    let learned_cm = 100.0
        * distance_to_line(
            &Point3::from(first.origin),
            &true_axis.normalize(),
            &Point3::from(joint.origin),
        );
    let state = &found.joints[0];
    let met_axis = Vector3::from(now.axis_last);
    let met_deg = line_angle(&met_axis, &Vector3::from(state.axis)).to_degrees();
    let sign = met_axis.dot(&Vector3::from(state.axis)).signum();
    let configuration = match (state.configuration, now.configuration.last()) {
        (Some(q), Some(truth)) => format!("{:.2}°", (sign * q - truth).abs().to_degrees()),
        _ => "not seen".to_owned(),
    };
    Ok(format!(
        "learned: {} joint, axis off by {learned_deg:.2}° and {learned_cm:.2} cm, range {:.2} rad of {:.2}\n\
         recognised: score {:.2}, axis off by {met_deg:.2}°, configuration off by {configuration}\n",
        joint.kind.name(),
        joint.range[1] - joint.range[0],
        first.range_observed[1] - first.range_observed[0],
        found.score,
    ))
}
