//! `linkage listen`: prints what a service publishes, for people.

use crate::cli::ListenArgs;
use crate::console::answer;
use crate::interrupt;
use crate::outcome::{Failure, Outcome};
use anyhow::anyhow;
use linkage_driver::plain_text::harmless;
use linkage_lcm::messages::linkage::{
    Joint, JointTrajectory, Model, Prediction, Recognition, Setpoint, Status,
};
use linkage_lcm::{DecodeError, Lcm, Packet, decode};
use linkage_planner_bridge::channel;
use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Longest wait for a packet before the thread checks whether it is to stop.
const POLL: Duration = Duration::from_millis(100);
/// Longest text of a line, bytes.
const LINE_LENGTH: usize = 4000;
/// Time between two lines of one channel that say nothing but other figures.
const FIGURES_EVERY: Duration = Duration::from_secs(1);

pub fn run(args: &ListenArgs) -> Outcome {
    let limit = args.seconds.map(Duration::try_from_secs_f64).transpose();
    let limit = limit.map_err(|e| anyhow!("--seconds: {e}"))?;
    let mut lcm = Lcm::new(&args.publish)?;
    for channel in [
        channel::STATUS,
        channel::MODEL,
        channel::RECOGNITION,
        channel::PREDICTION,
        channel::SETPOINT,
    ] {
        lcm.subscribe(channel)?;
    }
    let stop = interrupt::watch();
    let start = Instant::now();
    let (mut printed, mut heard) = (Printed::default(), false);
    while !stop.load(Ordering::Relaxed) && limit.is_none_or(|limit| start.elapsed() < limit) {
        let Some(packet) = lcm.receive(POLL)? else { continue };
        heard = true;
        let line = Line::of(&packet).unwrap_or_else(|e| Line {
            topic: e.to_string(),
            figures: String::new(),
            last: false,
        });
        if args.all || printed.is_news(&packet.channel, &line) {
            let name = packet.channel.trim_start_matches("LINKAGE_").to_lowercase();
            let seconds = start.elapsed().as_secs_f64();
            answer(format!("{seconds:8.2} s  {name:<12} {}", line.shown()))?;
        }
    }
    if heard {
        return Ok(());
    }
    let hint = "is \"linkage serve\" running on this network?";
    Err(Failure::no_answer(format!("{}: nothing was published; {hint}", args.publish)))
}

/// What was printed last of each channel.
#[derive(Default)]
struct Printed(HashMap<String, Before>);

/// The last line of a channel that was printed.
struct Before {
    topic: String,
    shown: String,
    at: Instant,
}

impl Printed {
    /// A line that says something new, or other figures after a while.
    fn is_news(&mut self, channel: &str, line: &Line) -> bool {
        let before = self.0.get(channel);
        let is_news = before.is_none_or(|before| {
            let is_due = before.at.elapsed() >= FIGURES_EVERY;
            // The last setpoint of a motion is sent several times.
            let is_setpoint = channel == channel::SETPOINT;
            let is_again = is_setpoint && before.shown == line.shown() && !is_due;
            line.last && !is_again
                || before.topic != line.topic
                || channel != channel::STATUS && is_due
        });
        if is_news {
            let (topic, shown) = (line.topic.clone(), line.shown());
            self.0.insert(channel.to_owned(), Before { topic, shown, at: Instant::now() });
        }
        is_news
    }
}

/// A message as it is shown: what it speaks of, and figures that change all the time.
struct Line {
    topic: String,
    figures: String,
    /// It ends something: always shown.
    last: bool,
}

impl Line {
    fn of(packet: &Packet) -> Result<Self, DecodeError> {
        let bytes = &packet.bytes;
        Ok(match packet.channel.as_str() {
            channel::STATUS => Self::of_status(&decode(bytes)?),
            channel::MODEL => Self::of_model(&decode(bytes)?),
            channel::RECOGNITION => Self::of_recognition(&decode(bytes)?),
            channel::PREDICTION => Self::of_prediction(&decode(bytes)?),
            channel::SETPOINT => Self::of_setpoint(&decode(bytes)?),
            other => Self {
                topic: format!("{other}, {} bytes", bytes.len()),
                figures: String::new(),
                last: false,
            },
        })
    }

    /// Anybody may publish what stands in it.
    fn shown(&self) -> String {
        harmless(&format!("{}{}", self.topic, self.figures), LINE_LENGTH)
    }

    fn of_status(status: &Status) -> Self {
        let mut topic = status.state.clone();
        if !status.object.is_empty() {
            topic += &format!(" {}", status.object);
        }
        if !status.command_answer.is_empty() {
            let verdict = match (status.command_accepted, status.command_done) {
                (false, _) => "refused",
                (true, true) => "done",
                (true, false) => "begun",
            };
            topic += &format!("; command {verdict}: {}", status.command_answer);
        }
        if !status.last_error.is_empty() {
            topic += &format!("; last error: {}", status.last_error);
        }
        let figures = format!(
            " ({:.1} frames/s, {} lost, {} refused)",
            status.frame_rate, status.dropped_frames, status.refused
        );
        Self { topic, figures, last: false }
    }

    fn of_model(model: &Model) -> Self {
        let joints: Vec<String> = model
            .joints
            .iter()
            .map(|j| {
                let [low, high] = j.range;
                format!("{} {} {low:.3} to {high:.3} {}", j.name, j.kind, unit(&j.kind))
            })
            .collect();
        let (what, last) = match model.demonstrations {
            0 => ("best guess so far of".to_owned(), false),
            n => (format!("after {n} demonstration(s):"), true),
        };
        let joints = if joints.is_empty() { "nothing moves".to_owned() } else { joints.join("; ") };
        Self { topic: format!("{what} {}", model.object), figures: format!(": {joints}"), last }
    }

    fn of_recognition(recognition: &Recognition) -> Self {
        let (mut topics, mut figures) = (Vec::new(), Vec::new());
        for m in &recognition.matches {
            let known = m.joints.iter().map(|j| match j.configuration_known {
                true => format!("{} known", j.name),
                false => format!("{} unknown: {}", j.name, j.reason),
            });
            topics.push(format!("{} ({})", m.object, known.collect::<Vec<_>>().join(", ")));
            let joints = m.joints.iter().filter(|j| j.configuration_known).map(configuration);
            figures.push(format!(" {:.2} {}", m.score, joints.collect::<Vec<_>>().join(", ")));
        }
        if topics.is_empty() {
            topics.push("nothing known is seen".to_owned());
        }
        Self { topic: topics.join("; "), figures: figures.join(";"), last: false }
    }

    fn of_prediction(prediction: &Prediction) -> Self {
        let joints: Vec<String> = prediction.trajectories.iter().map(trajectory).collect();
        let topic = format!("{}: {}", prediction.recognition.object, joints.join("; "));
        Self { topic, figures: String::new(), last: true }
    }

    fn of_setpoint(setpoint: &Setpoint) -> Self {
        let joints: Vec<String> = setpoint
            .joint_name
            .iter()
            .zip(setpoint.position.iter().zip(&setpoint.velocity))
            .map(|(name, (q, qd))| format!(" {name} at {q:.4}, moving {qd:+.4} a second"))
            .collect();
        let end = match (setpoint.last, setpoint.reason.as_str()) {
            (false, _) => String::new(),
            (true, "") => "; the motion is done".to_owned(),
            (true, reason) => format!("; the motion ends: {reason}"),
        };
        Self {
            topic: setpoint.object.clone(),
            figures: joints.join(",") + &end,
            last: setpoint.last,
        }
    }
}

fn unit(kind: &str) -> &'static str {
    if kind == "prismatic" { "m" } else { "rad" }
}

fn configuration(joint: &Joint) -> String {
    let unit = unit(&joint.kind);
    match joint.configuration_deviation {
        d if d > 0.0 => format!("{} at {:.3} ± {d:.3} {unit}", joint.name, joint.configuration),
        _ => format!("{} at {:.3} {unit}", joint.name, joint.configuration),
    }
}

fn trajectory(joint: &JointTrajectory) -> String {
    let first = |list: &[f64]| list.first().copied().unwrap_or(f64::NAN);
    let last = |list: &[f64]| list.last().copied().unwrap_or(f64::NAN);
    let seconds = joint.time_from_start_us.last().map_or(0.0, |us| *us as f64 * 1e-6);
    format!(
        "{} from {:.3} to {:.3} {} in {seconds:.2} s",
        joint.joint,
        first(&joint.position),
        last(&joint.position),
        unit(&joint.kind)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::plain_text::is_control;
    use linkage_lcm::encode;
    use linkage_lcm::messages::linkage::Match;

    fn recognition(known: bool, configuration: f64) -> Packet {
        let joint = Joint {
            name: "joint1".into(),
            kind: "revolute".into(),
            configuration_known: known,
            configuration,
            configuration_deviation: 0.01,
            reason: if known { String::new() } else { "hidden".into() },
            ..Joint::default()
        };
        let reasons = vec![joint.reason.clone()];
        let seen =
            Match { object: "fridge".into(), joints: vec![joint], reasons, ..Match::default() };
        let message = Recognition { matches: vec![seen], ..Recognition::default() };
        Packet {
            channel: channel::RECOGNITION.into(),
            bytes: encode(&message).unwrap(),
            received_utime: 0,
            sender: None,
        }
    }

    #[test]
    fn a_recognition_says_what_is_known_and_why_not() {
        let line = Line::of(&recognition(true, 0.5)).unwrap();
        assert_eq!(line.topic, "fridge (joint1 known)");
        assert!(line.figures.contains("joint1 at 0.500 ± 0.010 rad"), "{}", line.figures);
        assert_eq!(
            Line::of(&recognition(false, 0.0)).unwrap().topic,
            "fridge (joint1 unknown: hidden)"
        );
    }

    #[test]
    fn what_others_publish_does_nothing_to_a_terminal() {
        let forged = "\u{1b}]0;root\u{7}\r\nidle\u{202e}";
        let status =
            Status { state: forged.into(), last_error: forged.into(), ..Status::default() };
        let line = Line::of_status(&status).shown();
        assert!(line.contains(r"\u{1b}]0;root") && !line.contains(is_control), "{line}");
        let endless = Status { last_error: "x".repeat(1 << 20), ..Status::default() };
        assert!(Line::of_status(&endless).shown().len() < 5000);
    }

    #[test]
    fn only_what_says_something_new_is_printed_at_once() {
        let mut printed = Printed::default();
        let mut is_news = |p: &Packet| printed.is_news(&p.channel, &Line::of(p).unwrap());
        assert!(is_news(&recognition(true, 0.5)));
        assert!(!is_news(&recognition(true, 0.6)));
        assert!(is_news(&recognition(false, 0.0)));
    }
}
