//! Measures the wall time of each stage of learning.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Wall time spent in each stage.
#[derive(Debug, Clone, Default)]
pub struct StageTimes {
    stages: BTreeMap<&'static str, Duration>,
}

impl StageTimes {
    /// Runs a stage and adds its wall time to that of the same name.
    pub fn measure<T>(&mut self, stage: &'static str, run: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = run();
        *self.stages.entry(stage).or_default() += start.elapsed();
        result
    }

    /// Stages and their times, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, Duration)> + '_ {
        self.stages.iter().map(|(name, time)| (*name, *time))
    }
}
