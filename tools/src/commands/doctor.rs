//! `linkage doctor`: does this machine have what is needed?

use super::{Failure, Outcome};
use crate::cli::DoctorArgs;
use linkage_lcm::Lcm;
use linkage_planner_bridge::Rig;
use std::time::Duration;

pub fn run(args: &DoctorArgs) -> Outcome {
    let rig = Rig::default();
    let url = args.url.as_deref().unwrap_or(&rig.lcm_url);
    let checks = [
        ("vision library", vision()),
        ("processors", processors()),
        ("LCM network", lcm(url)),
        ("scratch space", scratch()),
    ];
    let mut failed = 0;
    for (what, result) in checks {
        match result {
            Ok(found) => println!("ok    {what}: {found}"),
            Err(problem) => {
                failed += 1;
                println!("FAIL  {what}: {problem:#}");
            }
        }
    }
    if failed > 0 {
        return Err(Failure::no_answer(format!("{failed} of the checks failed")));
    }
    Ok(())
}

fn vision() -> anyhow::Result<String> {
    Ok(format!("OpenCV {}", opencv::core::get_version_string()?))
}

fn processors() -> anyhow::Result<String> {
    Ok(format!("{} cores", std::thread::available_parallelism()?))
}

fn lcm(url: &str) -> anyhow::Result<String> {
    Lcm::new(url)?.self_test(Duration::from_secs(2))?;
    Ok(format!("{url} carries messages"))
}

fn scratch() -> anyhow::Result<String> {
    let dir = tempfile::tempdir()?;
    std::fs::write(dir.path().join("probe"), [0_u8; 4096])?;
    Ok(format!("{} can be written", std::env::temp_dir().display()))
}
