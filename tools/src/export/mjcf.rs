//! MJCF, as MuJoCo reads it.

use super::description::{Description, Motion};
use super::xml::{document, spaced};
use quick_xml::Writer;
use std::io::{self, Write};

/// The description as MJCF.
///
/// # Errors
/// For screws, which it has not.
pub fn mjcf(of: &Description) -> anyhow::Result<String> {
    let of = of.without_screws("MJCF")?;
    let text = document(|writer| {
        writer
            .create_element("mujoco")
            .with_attribute(("model", of.name.as_str()))
            .write_inner_content(|w| {
                w.create_element("compiler").with_attribute(("angle", "radian")).write_empty()?;
                w.create_element("worldbody").write_inner_content(|w| body(w, of, 0))?;
                Ok(())
            })
            .map(drop)
    })?;
    Ok(text)
}

/// A link within the one that carries it, with all that it carries.
fn body<W: Write>(writer: &mut Writer<W>, of: &Description, number: usize) -> io::Result<()> {
    let link = &of.links[number];
    let moved_by = of.joints.iter().find(|j| j.child == number);
    let at = moved_by.map_or(link.origin.coords, |j| of.in_parent(j));
    writer
        .create_element("body")
        .with_attributes([
            ("name", link.name.as_str()),
            ("pos", spaced(at.iter().copied()).as_str()),
        ])
        .write_inner_content(|w| {
            if let Some(joint) = moved_by {
                w.create_element("joint")
                    .with_attributes([
                        ("name", joint.name.as_str()),
                        ("type", if joint.motion == Motion::Turns { "hinge" } else { "slide" }),
                        ("axis", joint.axis.map(|x| x.to_string()).join(" ").as_str()),
                        ("limited", "true"),
                        ("range", joint.range.map(|q| q.to_string()).join(" ").as_str()),
                    ])
                    .write_empty()?;
            }
            if let Some(shape) = &link.shape {
                let q = shape.rotation;
                w.create_element("geom")
                    .with_attributes([
                        ("type", "box"),
                        ("size", spaced(shape.size.iter().map(|side| side / 2.0)).as_str()),
                        ("pos", spaced(shape.center.iter().copied()).as_str()),
                        ("quat", spaced([q.w, q.i, q.j, q.k]).as_str()),
                        ("mass", shape.mass().to_string().as_str()),
                    ])
                    .write_empty()?;
            }
            let carried = of.joints.iter().filter(|j| j.parent == number);
            carried.map(|j| j.child).try_for_each(|child| body(w, of, child))
        })
        .map(drop)
}
