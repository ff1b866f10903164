//! `linkage serve`: the live skill until Ctrl-C, SIGTERM, or its terminal closes.

use crate::cli::{Common, ServeArgs};
use crate::console::say;
use crate::interrupt;
use crate::outcome::Outcome;
use crate::report::describe_stream;
use crate::steps::skill_config;
use crate::view::{View, Wanted};
use anyhow::anyhow;
use linkage_driver::live::LiveConfig;
use linkage_driver::{SourceOptions, open_with};
use linkage_planner_bridge::Rig;
use linkage_planner_bridge::service::{
    Observer, Playback, ServiceConfig, ServiceReport, observer, serve_observed,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

pub fn run(args: &ServeArgs, common: &Common) -> Outcome {
    if !(args.rate.is_finite() && args.rate >= 0.0) {
        return Err(anyhow!("--rate must be 0 or above").into());
    }
    let rig = match &args.rig {
        Some(path) => Rig::read(path)?,
        None => Rig::default(),
    };
    let wanted = Wanted { mcap: args.mcap.clone(), address: args.view.clone() };
    let view = View::open(&wanted)?;
    let stop = interrupt::watch();
    let config = ServiceConfig {
        skill: skill_config(common)?,
        url: args.publish.clone().unwrap_or_else(|| rig.lcm_url.clone()),
        rig,
        store: args.store.clone(),
        stream_hz: args.stream_hz,
        playback: Playback { rate: args.rate, repeat: args.repeat },
    };
    let options = SourceOptions {
        camera: args.camera.as_deref().map(linkage_driver::read_camera_file).transpose()?,
        // A camera that is away for long may still come back.
        live: LiveConfig { give_up: Duration::MAX, ..LiveConfig::default() },
        stop: Arc::clone(&stop),
    };
    let name = args.source.clone();
    if !common.quiet {
        say(format!("serving {name} on {}; Ctrl-C ends it", config.url));
    }
    let serve = move |observer| {
        serve_observed(Box::new(move || open_with(&name, &options)), &config, &stop, observer)
    };
    let report = match view {
        None => serve(Observer::default())?,
        Some(view) => {
            let (observer, observations) = observer();
            let is_over = AtomicBool::new(false);
            let report = std::thread::scope(|scope| {
                scope.spawn(|| view.follow(&observations, &args.store, &is_over));
                let _over = SetOnDrop(&is_over);
                serve(observer)
            });
            let closed = view.close();
            let report = report?;
            closed?;
            report
        }
    };
    if !common.quiet {
        say(summary(&report).trim_end());
    }
    Ok(())
}

/// Tells that something is over, even where it ends by a panic.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// What was done, for people.
fn summary(report: &ServiceReport) -> String {
    let mut text = format!(
        "{} frames looked at, {} dropped, {} commands or packets refused\n",
        report.frames, report.dropped_frames, report.refused
    );
    if let Some(stream) = &report.stream {
        text += &describe_stream(stream);
    }
    text
}
