//! Answers as lines of text, for people.

use linkage_planner_bridge::service::StreamReport;
use linkage_skill::ObjectModel;
use linkage_skill::recognise::Recognised;
use std::fmt::Write;

/// A line for each joint of a model.
pub fn summary(model: &ObjectModel) -> String {
    let mut text = String::new();
    for j in &model.joints {
        let [low, high] = j.range;
        let _ = writeln!(
            text,
            "{} {}: {}{} of {} on {}, {:.2} to {:.2} {}, axis ({:.3}, {:.3}, {:.3})",
            model.object,
            j.name,
            if j.undecided { "undecided, perhaps " } else { "" },
            j.kind.name(),
            model.parts[j.child].name,
            model.parts[j.parent].name,
            low,
            high,
            j.kind.unit(),
            j.axis[0],
            j.axis[1],
            j.axis[2],
        );
    }
    text
}

/// A line for a recognised object, with its joints.
pub fn describe(m: &Recognised) -> String {
    let joints: Vec<String> = m
        .joints
        .iter()
        .map(|j| match j.configuration {
            Some(q) => format!("{} at {q:.3} {}", j.name, j.kind.unit()),
            None => format!("{} not known: {}", j.name, j.reason.as_deref().unwrap_or("not seen")),
        })
        .collect();
    format!("{}: score {:.2}, {} inliers, {}\n", m.object, m.score, m.inliers, joints.join(", "))
}

/// How a stream kept its time.
pub fn describe_stream(stream: &StreamReport) -> String {
    let l = &stream.lateness;
    format!(
        "{} setpoints sent, {} not taken by the network; {} deadlines missed, late by {} us median, {} us p99, {} us at most\n",
        stream.sent,
        stream.failed,
        l.missed(),
        l.quantile_us(0.5),
        l.quantile_us(0.99),
        l.longest_us()
    )
}
