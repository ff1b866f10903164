//! The kinematic tree of an object as nested lists: which part carries which, by which joint.

use super::layout::part_style;
use super::units::amount;
use super::words::kind_in_words;
use linkage_skill::object::ObjectModel;
use maud::{Markup, html};

/// The base, and below each part what it carries.
pub fn tree(model: &ObjectModel) -> Markup {
    html! { div.tree { ul { (branch(model, 0, model.parts.len())) } } }
}

/// A part and what it carries; `depth` bounds how deep a list may go.
fn branch(model: &ObjectModel, part: usize, depth: usize) -> Markup {
    let name = model.parts.get(part).map_or("?", |p| p.name.as_str());
    let carried: Vec<_> = model.joints.iter().filter(|j| j.parent == part).collect();
    let by = model.joints.iter().find(|j| j.child == part);
    html! {
        li {
            span.key style=(part_style(part)) {}
            (name)
            @if let Some(j) = by {
                " moves by " (j.name) ", " (kind_in_words(j.kind)) ", "
                (amount(j.kind, j.range[0])) " to " (amount(j.kind, j.range[1]))
            }
            @if !carried.is_empty() && depth > 0 {
                ul { @for j in &carried { (branch(model, j.child, depth - 1)) } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::object::{Joint, JointGeometry, MODEL_SCHEMA, Part, ReferenceFrame};
    use nalgebra::{Point3, Vector3};

    #[test]
    fn a_drawer_in_a_door_is_a_list_in_its_list() {
        let line = JointGeometry::slide(Vector3::z_axis(), Point3::origin());
        let joint = |parent: usize| Joint {
            name: format!("joint{}", parent + 1),
            parent,
            child: parent + 1,
            range: [0.0, 0.3],
            ..Joint::of(&line)
        };
        let model = ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: "fridge".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: (0..3).map(|i| Part::new(i, format!("part{i}"), 1)).collect(),
            joints: vec![joint(0), joint(1)],
            demonstrations: 1,
            profile: "default".to_owned(),
            version: "0".to_owned(),
        };
        let text = tree(&model).into_string();
        let (door, drawer) = (text.find("part1").unwrap(), text.find("part2").unwrap());
        assert!(door < drawer && text[door..drawer].contains("<ul>"), "{text}");
        assert!(text.contains("part2 moves by joint2, a slide, 0 mm to 30 cm"), "{text}");
    }
}
