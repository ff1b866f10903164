//! The scenes: things that people open, and rooms to put them in.

use super::furniture::{
    cabinet, door, drawers, fridge, furnish, hand_only, laptop, lid_box, microwave, office_chair,
    rising_door, sliding_door, stand_of, twins,
};
use super::kit::{Look, Palette, WHITE, cuboid};
use super::texture::Richness;
use super::world::Scene;
use super::{devices, instances};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Names of all scenes, with what happens.
pub const SCENES: [(&str, &str); 20] = [
    ("door", "a room's door is opened and closed"),
    ("drawer", "a drawer is pulled and pushed"),
    ("two_drawers", "two drawers, one after the other"),
    ("fridge", "a fridge is opened and closed"),
    ("microwave", "a microwave is opened and closed"),
    ("laptop", "a laptop's lid is opened and closed"),
    ("sliding_door", "a sliding door is opened and closed"),
    ("cabinet", "a cabinet's door is opened and closed"),
    ("office_chair", "a chair's seat is turned, then its back is tilted"),
    ("hand_only", "a hand touches a thing that does not move"),
    ("moving_camera", "a drawer, watched by a camera held by hand"),
    ("lid_box", "the lid of a chest is opened and closed"),
    ("printer", "a printer's tray is pulled and pushed"),
    ("scanner", "the lid of a printer's scanner is opened and closed"),
    ("screen", "a screen is tilted"),
    ("monitor", "a monitor is turned, then tilted"),
    ("bicycle", "a bicycle is steered, pedalled, its wheel turned"),
    ("stool", "a stool's seat is screwed up and down"),
    ("rising_door", "a door that its hinges lift is opened and closed"),
    ("two_laptops", "two laptops of one make, one after the other"),
];

/// Builds a scene in the room of a seed; `None` for an unknown name.
pub fn scene(name: &str, seed: u64) -> Option<Scene> {
    let Some(mut scene) = thing(name, name) else { return instances::demonstration(name) };
    furnish(&mut scene, seed);
    Some(scene)
}

/// A thing of the same shape with another surface; `None` for an unknown name.
pub fn repainted(name: &str, seed: u64) -> Option<Scene> {
    let mut scene = thing(name, &format!("another {name}"))?;
    furnish(&mut scene, seed);
    Some(scene)
}

/// A thing of the same surface with another shape; `None` for an unknown name.
pub fn reproportioned(name: &str, seed: u64) -> Option<Scene> {
    let mut scene = thing(name, name)?;
    instances::stretch_about_its_stand(&mut scene, &Vector3::new(1.35, 1.1, 0.75));
    furnish(&mut scene, seed);
    Some(scene)
}

/// The thing that a scene is about, painted after a name; no room yet.
fn thing(name: &str, painted_after: &str) -> Option<Scene> {
    let richness = match name {
        "cabinet" | "lid_box" => Richness::Medium,
        _ => Richness::Rich,
    };
    let look = Look { name: painted_after, richness };
    let mut scene = match name {
        "door" => door(look),
        "drawer" => drawers(look, 1),
        "two_drawers" => drawers(look, 2),
        "fridge" => fridge(look),
        "microwave" => microwave(look),
        "laptop" => laptop(look),
        "sliding_door" => sliding_door(look),
        "cabinet" => cabinet(look),
        "office_chair" => office_chair(look),
        "hand_only" => hand_only(look),
        "moving_camera" => Scene { moving_camera: true, ..drawers(look, 1) },
        "lid_box" => lid_box(look),
        "printer" => devices::printer_tray(look),
        "scanner" => devices::printer_lid(look),
        "screen" => devices::screen(look),
        "monitor" => devices::monitor(look),
        "bicycle" => devices::bicycle(look),
        "stool" => devices::stool(look),
        "rising_door" => rising_door(look),
        "two_laptops" => twins(thing("laptop", "laptop")?, 0.5),
        _ => return None,
    };
    scene.name = name.to_owned();
    Some(scene)
}

/// Things that are in every room of a household, each time elsewhere.
pub fn add_common_clutter(scene: &mut Scene, seed: u64) {
    let mut place = ChaCha8Rng::seed_from_u64(seed ^ 0x6e11);
    let top = stand_of(scene).unwrap_or(0.0);
    for (number, size) in
        [[0.22, 0.10, 0.28], [0.12, 0.12, 0.20], [0.28, 0.18, 0.09]].into_iter().enumerate()
    {
        let name = format!("clutter {number}");
        let paint = Palette::new(Look { name: &name, richness: Richness::Rich }).paint(WHITE);
        let side = if place.random_bool(0.5) { 1.0 } else { -1.0 };
        let x = side * place.random_range(0.6..1.0);
        let y = place.random_range(-0.15..0.3);
        scene.surroundings.push(cuboid([x, y, top + 0.5 * size[2]], size, &paint, 0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_of_the_list_can_be_built_and_no_other() {
        for (name, _) in SCENES {
            let built = scene(name, 1).unwrap();
            assert_eq!(built.name, name);
            assert!(!built.surroundings.is_empty(), "{name} stands in no room");
        }
        assert!(scene("castle", 1).is_none());
    }
}
