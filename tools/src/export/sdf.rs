//! SDFormat, as Gazebo and Drake read it.

use super::description::{Cuboid, Description, Hinge, Link, Motion};
use super::xml::{document, spaced};
use quick_xml::Writer;
use quick_xml::events::BytesText;
use std::io::{self, Write};

/// The description as SDF 1.9; with screws as 1.10, which was the first to say what the pitch of one
/// is.
///
/// # Errors
/// Whatever the writer says.
pub fn sdf(of: &Description) -> anyhow::Result<String> {
    let version = if of.joints.iter().any(Hinge::is_screw) { "1.10" } else { "1.9" };
    let text = document(|writer| {
        writer
            .create_element("sdf")
            .with_attribute(("version", version))
            .write_inner_content(|w| {
                w.create_element("model")
                    .with_attribute(("name", of.name.as_str()))
                    .write_inner_content(|w| {
                        of.links.iter().try_for_each(|l| link(w, l))?;
                        of.joints.iter().try_for_each(|j| joint(w, of, j))
                    })
                    .map(drop)
            })
            .map(drop)
    })?;
    Ok(text)
}

fn text<W: Write>(writer: &mut Writer<W>, name: &str, words: &str) -> io::Result<()> {
    writer.create_element(name).write_text_content(BytesText::new(words)).map(drop)
}

fn link<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    writer
        .create_element("link")
        .with_attribute(("name", link.name.as_str()))
        .write_inner_content(|w| {
            text(w, "pose", &format!("{} 0 0 0", spaced(link.origin.iter().copied())))?;
            let Some(shape) = &link.shape else { return Ok(()) };
            inertial(w, shape)?;
            for purpose in ["visual", "collision"] {
                w.create_element(purpose).with_attribute(("name", purpose)).write_inner_content(
                    |w| {
                        pose(w, shape)?;
                        w.create_element("geometry").write_inner_content(|w| {
                            w.create_element("box")
                                .write_inner_content(|w| {
                                    text(w, "size", &spaced(shape.size.iter().copied()))
                                })
                                .map(drop)
                        })?;
                        Ok(())
                    },
                )?;
            }
            Ok(())
        })
        .map(drop)
}

fn pose<W: Write>(writer: &mut Writer<W>, shape: &Cuboid) -> io::Result<()> {
    let pose = format!("{} {}", spaced(shape.center.iter().copied()), spaced(shape.rpy()));
    text(writer, "pose", &pose)
}

fn inertial<W: Write>(writer: &mut Writer<W>, shape: &Cuboid) -> io::Result<()> {
    writer
        .create_element("inertial")
        .write_inner_content(|w| {
            pose(w, shape)?;
            text(w, "mass", &shape.mass().to_string())?;
            w.create_element("inertia").write_inner_content(|w| {
                for (name, moment) in ["ixx", "iyy", "izz"].iter().zip(shape.inertia()) {
                    text(w, name, &moment.to_string())?;
                }
                Ok(())
            })?;
            Ok(())
        })
        .map(drop)
}

fn joint<W: Write>(writer: &mut Writer<W>, of: &Description, joint: &Hinge) -> io::Result<()> {
    writer
        .create_element("joint")
        .with_attributes([("name", joint.name.as_str()), ("type", joint.kind())])
        .write_inner_content(|w| {
            text(w, "parent", &of.links[joint.parent].name)?;
            text(w, "child", &of.links[joint.child].name)?;
            if let Motion::Screws(pitch) = joint.motion {
                text(w, "screw_thread_pitch", &pitch.to_string())?;
            }
            w.create_element("axis").write_inner_content(|w| {
                text(w, "xyz", &joint.axis.map(|x| x.to_string()).join(" "))?;
                w.create_element("limit").write_inner_content(|w| {
                    text(w, "lower", &joint.range[0].to_string())?;
                    text(w, "upper", &joint.range[1].to_string())
                })?;
                Ok(())
            })?;
            Ok(())
        })
        .map(drop)
}
