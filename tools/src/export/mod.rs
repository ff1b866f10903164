//! Learned objects as robot descriptions that simulators and planners read.
//!
//! Every link's frame has the axes of the object frame, and its origin on the joint that moves
//! it; at configuration 0 the links are where the demonstration began.

mod description;
mod mjcf;
mod sdf;
mod urdf;
mod xml;

pub use description::Description;
pub use mjcf::mjcf;
pub use sdf::sdf;
pub use urdf::urdf;

#[cfg(test)]
mod tests {
    use super::description::{Cuboid, Hinge, LEAST_SIDE_M, Link, Motion, hinge};
    use super::*;
    use linkage_skill::object::joint_geometry::JointKind;
    use linkage_skill::object::model::Joint;
    use nalgebra::{Point3, Vector3};

    fn model_joint(kind: JointKind) -> Joint {
        let value = serde_json::json!({
            "name": "latch", "parent": 0, "child": 1, "type": kind, "axis": [1.0, 0.0, 0.0],
            "origin": [0.0, 0.0, 0.0], "pitch": 0.09, "range": [0.0, 1.0], "covariance": [],
            "observations": 0, "bic": 0.0, "log_likelihood": 0.0, "position_rmse": 0.0,
            "orientation_rmse": 0.0, "configuration": [],
        });
        serde_json::from_value(value).expect("it has every field")
    }

    /// A door of 40 cm by 80 cm on a hinge, with a handle that slides upon it.
    fn cupboard() -> Description {
        let origins = [[0.0; 3], [0.2, 0.1, 1.0], [0.5, 0.1, 1.0]].map(Point3::from);
        let door: Vec<Vector3<f64>> = (0..41)
            .flat_map(|i| (0..81).map(move |k| [0.01 * f64::from(i), 0.01 * f64::from(k), 0.0]))
            .map(|p| Vector3::from(p) - Vector3::new(0.0, 0.1, 0.0))
            .collect();
        let link = |name: &str, origin, surface: &[Vector3<f64>]| Link {
            name: name.to_owned(),
            origin,
            shape: Cuboid::around(surface),
        };
        let joint = |name: &str, parent, motion, axis, range| Hinge {
            name: name.to_owned(),
            parent,
            child: parent + 1,
            motion,
            axis,
            range,
        };
        Description {
            name: "cup & board".to_owned(),
            links: vec![
                link("base", origins[0], &[]),
                link("door", origins[1], &door),
                link("handle", origins[2], &[]),
            ],
            joints: vec![
                joint("hinge", 0, Motion::Turns, [0.0, 1.0, 0.0], [0.0, 1.5]),
                joint("latch", 1, Motion::Slides, [1.0, 0.0, 0.0], [-0.1, 0.0]),
            ],
        }
    }

    #[test]
    fn a_reader_of_urdf_finds_the_joints_where_they_were_learned() {
        let description = cupboard();
        let robot = urdf_rs::read_from_string(&urdf(&description).unwrap()).unwrap();
        assert_eq!((robot.name.as_str(), robot.links.len()), ("cup & board", 3));
        let mut at = Vector3::zeros();
        for (read, written) in robot.joints.iter().zip(&description.joints) {
            at += Vector3::from(*read.origin.xyz);
            let child = &description.links[written.child];
            assert!((at - child.origin.coords).norm() < 1e-8, "{}", written.name);
            assert_eq!(*read.axis.xyz, written.axis);
            assert_eq!([read.limit.lower, read.limit.upper], written.range);
            assert_eq!(read.child.link, child.name);
        }
        assert!(matches!(robot.joints[0].joint_type, urdf_rs::JointType::Revolute));
        assert!(matches!(robot.joints[1].joint_type, urdf_rs::JointType::Prismatic));
    }

    #[test]
    fn the_box_is_the_surface_s() {
        let description = cupboard();
        let shape = description.links[1].shape.as_ref().unwrap();
        let mut sides: Vec<f64> = shape.size.iter().copied().collect();
        sides.sort_by(f64::total_cmp);
        for (side, wanted) in sides.iter().zip([LEAST_SIDE_M, 0.4, 0.8]) {
            assert!((side - wanted).abs() < 0.03, "{sides:?}");
        }
        assert!((shape.center - Point3::new(0.2, 0.3, 0.0)).norm() < 0.02);
        assert!(description.links[0].shape.is_none());
    }

    #[test]
    fn mjcf_nests_what_moves_with_what_and_sdf_places_every_link() {
        let text = mjcf(&cupboard()).unwrap();
        let place = |what: &str| text.find(what).unwrap_or_else(|| panic!("{what} in {text}"));
        let order = ["body name=\"base\"", "body name=\"door\"", "body name=\"handle\"", "</body>"];
        assert!(order.windows(2).all(|w| place(w[0]) < place(w[1])), "{text}");
        assert!(text.contains("type=\"slide\"") && text.contains("model=\"cup &amp; board\""));
        let text = sdf(&cupboard()).unwrap();
        assert!(text.contains("<pose>0.200000000 0.100000000 1.000000000 0 0 0</pose>"), "{text}");
    }

    #[test]
    fn a_screw_is_written_where_the_format_has_screws_and_refused_by_name_elsewhere() {
        let screw = hinge(&model_joint(JointKind::Helical)).unwrap();
        let (parent, child) = (1, 2);
        let description = Description {
            joints: vec![cupboard().joints.swap_remove(0), Hinge { parent, child, ..screw }],
            ..cupboard()
        };
        let text = sdf(&description).unwrap();
        for wanted in ["version=\"1.10\"", "type=\"screw\"", "<screw_thread_pitch>0.09<"] {
            assert!(text.contains(wanted), "{wanted} in {text}");
        }
        for refused in [urdf(&description), mjcf(&description)] {
            assert!(refused.unwrap_err().to_string().contains("latch is helical"));
        }
    }

    #[test]
    fn a_joint_that_no_format_can_hold_is_refused_by_name() {
        let refused = hinge(&model_joint(JointKind::Nonparametric)).err().unwrap().to_string();
        assert!(refused.contains("latch is nonparametric"), "{refused}");
    }
}
