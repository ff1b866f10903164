//! MJCF, as MuJoCo reads it. The base is fixed to the world.

use super::cuboid::Cuboid;
use super::description::{Description, Link};
use super::joint::{Hinge, Motion};
use super::names::{legal, plain};
use super::xml::{document, element, empty, spaced};
use quick_xml::Writer;
use std::io::{self, Write};

/// The description as MJCF.
///
/// # Errors
/// For screws, which it has not.
pub fn mjcf(of: &Description) -> anyhow::Result<String> {
    let of = &legal(of.without_screws("MJCF")?, plain, &["world"]);
    let text = document(&of.remarks(), |writer| {
        element(writer, "mujoco", &[("model", &of.name)], |w| {
            empty(w, "compiler", &[("angle", "radian"), ("autolimits", "true")])?;
            if of.links.iter().any(|l| l.mesh.is_some()) {
                element(w, "asset", &[], |w| of.links.iter().try_for_each(|l| asset(w, l)))?;
            }
            element(w, "worldbody", &[], |w| body(w, of, 0))?;
            if of.joints.is_empty() {
                return Ok(());
            }
            let joined = of.joints.iter().map(|j| [j.parent, j.child]);
            let mut excluded = joined.chain(of.overlapping());
            element(w, "contact", &[], |w| excluded.try_for_each(|pair| exclude(w, of, pair)))
        })
    })?;
    Ok(text)
}

fn asset<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    match &link.mesh {
        None => Ok(()),
        Some(mesh) => empty(writer, "mesh", &[("name", &link.name), ("file", &mesh.file)]),
    }
}

/// MuJoCo lets bodies that are fixed to the world collide with their own children, and throws apart what overlaps.
fn exclude<W: Write>(writer: &mut Writer<W>, of: &Description, pair: [usize; 2]) -> io::Result<()> {
    let names = pair.map(|link| of.links[link].name.as_str());
    empty(writer, "exclude", &[("body1", names[0]), ("body2", names[1])])
}

/// A link within the one that carries it, with all that it carries.
fn body<W: Write>(writer: &mut Writer<W>, of: &Description, number: usize) -> io::Result<()> {
    let link = &of.links[number];
    let moved_by = of.joints.iter().find(|j| j.child == number);
    let at = moved_by.map_or(link.origin.coords, |j| of.in_parent(j));
    let at = spaced(at.iter().copied());
    element(writer, "body", &[("name", &link.name), ("pos", &at)], |w| {
        inertial(w, link)?;
        if let Some(moved_by) = moved_by {
            joint(w, moved_by)?;
        }
        let [r, g, b] = link.colour;
        let rgba = format!("{r:.3} {g:.3} {b:.3} 1");
        if link.mesh.is_some() {
            let seen = [("type", "mesh"), ("mesh", link.name.as_str()), ("rgba", &rgba)];
            let apart = [("contype", "0"), ("conaffinity", "0"), ("group", "2"), ("mass", "0")];
            empty(w, "geom", &[seen.as_slice(), apart.as_slice()].concat())?;
        }
        // Viewers show groups 0 to 2 unless told otherwise.
        let group = if link.mesh.is_some() { "3" } else { "0" };
        link.boxes.iter().try_for_each(|b| geom(w, b, &rgba, group))?;
        let carried = of.joints.iter().filter(|j| j.parent == number);
        carried.map(|j| j.child).try_for_each(|child| body(w, of, child))
    })
}

fn inertial<W: Write>(writer: &mut Writer<W>, link: &Link) -> io::Result<()> {
    let at = spaced(link.inertia.center.iter().copied());
    let i = &link.inertia.moments;
    let moments = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|k| i[k].to_string());
    let (mass, moments) = (link.inertia.mass_kg.to_string(), moments.join(" "));
    empty(writer, "inertial", &[("pos", &at), ("mass", &mass), ("fullinertia", &moments)])
}

fn joint<W: Write>(writer: &mut Writer<W>, joint: &Hinge) -> io::Result<()> {
    let kind = if joint.motion == Motion::Turns { "hinge" } else { "slide" };
    let (axis, range) = (joint.axis(), joint.range);
    let [axis, range] = [axis.as_slice(), &range]
        .map(|numbers| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" "));
    let (damping, friction) = (joint.damping.to_string(), joint.friction.to_string());
    let force = format!("{} {}", -joint.effort, joint.effort);
    let attributes = [
        ("name", joint.name.as_str()),
        ("type", kind),
        ("axis", &axis),
        ("range", &range),
        ("actuatorfrcrange", &force),
        ("damping", &damping),
        ("frictionloss", &friction),
    ];
    empty(writer, "joint", &attributes)
}

fn geom<W: Write>(w: &mut Writer<W>, shape: &Cuboid, rgba: &str, group: &str) -> io::Result<()> {
    let q = shape.rotation;
    let half = spaced(shape.size.iter().map(|side| side / 2.0));
    let (at, turned) = (spaced(shape.center.iter().copied()), spaced([q.w, q.i, q.j, q.k]));
    let attributes = [
        ("type", "box"),
        ("size", half.as_str()),
        ("pos", &at),
        ("quat", &turned),
        ("rgba", rgba),
        ("group", group),
    ];
    empty(w, "geom", &attributes)
}
