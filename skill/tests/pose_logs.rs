//! Real pose logs of doors, drawers, dishwashers, cabinets (`$LINKAGE_DATA/pose_logs`): the
//! right joint type in every log whose type is known.

use linkage_skill::articulation::{fit_models, read_pose_log};
use linkage_skill::object::JointKind;
use std::path::{Path, PathBuf};

fn pose_logs() -> Option<PathBuf> {
    let data = std::env::var("LINKAGE_DATA").map_or_else(
        |_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let logs = data.join("pose_logs");
    logs.join("catalogue.csv").is_file().then_some(logs)
}

#[test]
fn every_log_of_known_type_is_told_right() {
    let Some(logs) = pose_logs() else {
        eprintln!("ignored: no pose_logs under $LINKAGE_DATA");
        return;
    };
    let catalogue = std::fs::read_to_string(logs.join("catalogue.csv")).unwrap();
    let mut wrong = Vec::new();
    let mut typed = 0;
    for line in catalogue.lines().skip(1) {
        let mut fields = line.split(',');
        let (file, expected) = (fields.next().unwrap(), fields.next().unwrap());
        let expected = match expected {
            "revolute" => JointKind::Revolute,
            "prismatic" => JointKind::Prismatic,
            _ => continue,
        };
        typed += 1;
        let samples = read_pose_log(&logs.join(file), None).unwrap().samples;
        let fitted = fit_models(&samples).unwrap();
        for f in &fitted {
            eprintln!(
                "{file} {:?} {:?} bic {:.1} n {:.1} rmse {:.2} mm r {:.2} out {:.2}",
                expected,
                f.geometry.kind,
                f.bic,
                f.effective_observations,
                1000.0 * f.position_rmse,
                (f.rest_position - f.geometry.origin).norm(),
                f.outlier_ratio
            );
        }
        if fitted[0].geometry.kind != expected {
            wrong.push(format!("{file}: {:?} instead of {expected:?}", fitted[0].geometry.kind));
        }
    }
    assert_eq!(typed, 47);
    assert!(wrong.is_empty(), "{wrong:#?}");
}
