//! Surfaces as homes have them: paint, wood, metal, tiles, boards, cloth, printed boxes, labels.
//!
//! In: a scene in its room, painted with speckles everywhere. Out: the same scene with other surfaces; nothing else
//! changes. On speckles every feature tracker finds thousands of corners; on paint it finds the edges and the handle.

use super::texture::{SIDE, Texture, TextureClass, add_noise};
use super::world::{Form, Material, Scene, Solid};
use clap::ValueEnum;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::PathBuf;
use std::sync::Arc;

/// Surfaces of a simulated scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Surfaces {
    /// Speckles on everything.
    Speckled,
    /// Those of a home: half of the things are plain, a quarter is medium, a quarter rich.
    Home,
    /// Those of a home, every thing plain.
    Plain,
}

impl Surfaces {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Speckled => "speckled",
            Self::Home => "home",
            Self::Plain => "plain",
        }
    }

    /// Folder of recordings with these surfaces, beside that of the speckled ones.
    pub fn folder(self, speckled: &str) -> PathBuf {
        match self {
            Self::Speckled => PathBuf::from(speckled),
            other => PathBuf::from(format!("{speckled}-{}", other.name())),
        }
    }

    /// Texture of the thing with this number; `None` if speckles stay on it.
    pub fn texture(self, number: u64) -> Option<TextureClass> {
        match self {
            Self::Speckled => None,
            Self::Plain => Some(TextureClass::Plain),
            Self::Home => Some(match number % 4 {
                0 | 2 => TextureClass::Plain,
                1 => TextureClass::Medium,
                _ => TextureClass::Rich,
            }),
        }
    }
}

/// Gives the scene surfaces of a home, with a thing of this texture; without one the scene stays as it is. The surfaces
/// of the thing follow from its name, those of the room from the seed.
pub fn paint(scene: &mut Scene, texture: Option<TextureClass>, seed: u64) {
    let Some(class) = texture else { return };
    scene.texture = Some(class);
    let name = scene.name.bytes().fold(7_u64, |h, b| h.wrapping_mul(31) ^ u64::from(b));
    let mut thing = Painter { rng: ChaCha8Rng::seed_from_u64(name ^ 0x40e5), done: Vec::new() };
    for solid in scene.parts.iter_mut().flat_map(|part| &mut part.solids) {
        thing.repaint(solid, |colour, rng| on_thing(colour, class, rng));
    }
    let mut room = Painter { rng: ChaCha8Rng::seed_from_u64(seed ^ 0x400e), done: Vec::new() };
    for solid in &mut scene.surroundings {
        let role = Role::of(solid);
        room.repaint(solid, |_, rng| in_room(role, rng));
    }
}

/// Cloth and skin of a person at home.
pub fn clothes(seed: u64) -> [Material; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xc107);
    let cloth =
        [[58.0, 66.0, 92.0], [128.0, 126.0, 122.0], [96.0, 52.0, 48.0], [196.0, 190.0, 182.0]];
    let sleeve = Finish::Cloth.material(*cloth.choose(&mut rng).unwrap_or(&cloth[0]), &mut rng);
    let skin = Finish::Paint.material([205.0, 155.0, 130.0], &mut rng);
    [sleeve, skin]
}

/// Gives solids of one old material one new material.
struct Painter {
    rng: ChaCha8Rng,
    done: Vec<(Arc<Texture>, Material)>,
}

impl Painter {
    fn repaint(
        &mut self,
        solid: &mut Solid,
        make: impl FnOnce([f64; 3], &mut ChaCha8Rng) -> Material,
    ) {
        let old = &solid.material.texture;
        let known = self.done.iter().find(|(painted, _)| Arc::ptr_eq(painted, old));
        solid.material = match known {
            Some((_, new)) => new.clone(),
            None => {
                let new = make(old.colour, &mut self.rng);
                self.done.push((old.clone(), new.clone()));
                new
            }
        };
    }
}

/// What a solid of the room is.
#[derive(Clone, Copy)]
enum Role {
    Floor,
    Wall,
    Table,
    Clutter,
}

impl Role {
    /// By its size: floor and wall are the only solids wider than 5 m, a table is the only one wider than 1.5 m.
    fn of(solid: &Solid) -> Self {
        let Form::Box(b) = &solid.form else { return Self::Clutter };
        let [x, y, z] = b.half_extents.to_array();
        match x {
            x if x > 2.5 && z < y => Self::Floor,
            x if x > 2.5 => Self::Wall,
            x if x > 0.75 => Self::Table,
            _ => Self::Clutter,
        }
    }
}

fn in_room(role: Role, rng: &mut ChaCha8Rng) -> Material {
    const WALLS: [[f64; 3]; 4] = [
        [214.0, 212.0, 206.0],
        [198.0, 192.0, 178.0],
        [176.0, 184.0, 188.0],
        [190.0, 200.0, 186.0],
    ];
    const WOODS: [[f64; 3]; 3] = [[172.0, 130.0, 88.0], [120.0, 84.0, 58.0], [196.0, 168.0, 128.0]];
    let wall = *WALLS.choose(rng).unwrap_or(&WALLS[0]);
    let wood = *WOODS.choose(rng).unwrap_or(&WOODS[0]);
    let print = [0, 1, 2].map(|_| rng.random_range(50.0..215.0));
    match role {
        Role::Wall if rng.random_bool(0.25) => Finish::Tiles(96).material(wall, rng),
        Role::Wall => Finish::Paint.material(wall, rng),
        Role::Floor if rng.random_bool(0.4) => Finish::Tiles(192).material(wall, rng),
        Role::Floor => Finish::Boards.material(wood, rng),
        Role::Table if rng.random_bool(0.4) => Finish::Paint.material(wall, rng),
        Role::Table => Finish::Wood(0.8).material(wood, rng),
        Role::Clutter if rng.random_bool(0.4) => Finish::Paint.material(print, rng),
        Role::Clutter => Finish::Print.material(print, rng),
    }
}

fn on_thing(colour: [f64; 3], class: TextureClass, rng: &mut ChaCha8Rng) -> Material {
    let is_wooden = colour[0] > colour[2] + 40.0;
    let is_metallic = colour[0] < 130.0 && rng.random_bool(0.5);
    let labelled = rng.random_bool(0.5);
    let finish = match class {
        TextureClass::Plain if is_wooden => Finish::Wood(0.25),
        TextureClass::Plain if is_metallic => Finish::Metal,
        TextureClass::Plain => Finish::Paint,
        TextureClass::Medium if is_wooden || !labelled => Finish::Wood(0.8),
        TextureClass::Medium => Finish::Labelled(8),
        TextureClass::Rich if is_wooden => Finish::Wood(1.6),
        TextureClass::Rich => Finish::Labelled(30),
    };
    finish.material(colour, rng)
}

/// How a surface is made.
#[derive(Clone, Copy)]
enum Finish {
    /// Rolled paint: nearly uniform.
    Paint,
    /// Brushed metal: fine level lines, and readings of depth that get lost.
    Metal,
    /// Upright grain of this strength; 1 is oak.
    Wood(f64),
    /// Tiles with so many texels on a side, which must divide the surface.
    Tiles(usize),
    /// Floor boards.
    Boards,
    /// Woven cloth with folds.
    Cloth,
    /// A printed box: fields of colour with lines of text.
    Print,
    /// Paint with so many labels and magnets.
    Labelled(usize),
}

impl Finish {
    fn material(self, colour: [f64; 3], rng: &mut ChaCha8Rng) -> Material {
        let mut light = vec![0.0_f32; SIDE * SIDE];
        self.shade(&mut light, rng);
        let mut texels: Vec<[f32; 3]> =
            light.iter().map(|l| colour.map(|c| c as f32 + l)).collect();
        let labels = match self {
            Self::Print => 60,
            Self::Labelled(count) => count,
            _ => 0,
        };
        for _ in 0..labels {
            add_label(&mut texels, rng);
        }
        let depth_loss = if matches!(self, Self::Metal) { 0.02 } else { 0.004 };
        Material { texture: Arc::new(Texture::of_texels(colour, texels)), depth_loss }
    }

    /// Lighter and darker places, by noise of (width, height) in texels and amplitude in grey levels.
    fn shade(self, light: &mut [f32], rng: &mut ChaCha8Rng) {
        let noise: &[([usize; 2], f64)] = match self {
            Self::Paint | Self::Labelled(_) | Self::Print => &[([96, 96], 1.2), ([4, 4], 0.8)],
            Self::Metal => &[([128, 2], 2.5), ([96, 96], 2.0)],
            Self::Wood(_) => &[([3, 96], 6.0), ([8, 192], 8.0), ([32, 256], 9.0)],
            Self::Boards => &[([3, 96], 4.0), ([12, 192], 6.0)],
            Self::Tiles(_) => &[([48, 48], 1.5), ([4, 4], 0.8)],
            Self::Cloth => &[([2, 3], 5.0), ([96, 128], 9.0), ([24, 48], 4.0)],
        };
        let strength = if let Self::Wood(strength) = self { strength } else { 1.0 };
        for (cell, amplitude) in noise {
            add_noise(light, *cell, strength * amplitude, rng);
        }
        match self {
            Self::Tiles(side) => add_fields(light, [side, side], 3.0, -38.0, rng),
            Self::Boards => add_fields(light, [64, 384], 9.0, -30.0, rng),
            _ => {}
        }
    }
}

/// Rectangles of (width, height) in texels, each a little lighter or darker, with joints of 3 texels between them.
fn add_fields(
    light: &mut [f32],
    [width, height]: [usize; 2],
    uneven: f64,
    joint: f32,
    rng: &mut ChaCha8Rng,
) {
    let columns = SIDE / width;
    let shades: Vec<f32> = (0..columns * SIDE.div_ceil(height))
        .map(|_| rng.random_range(-uneven..uneven) as f32)
        .collect();
    for (texel, light) in light.iter_mut().enumerate() {
        let (u, v) = (texel % SIDE, texel / SIDE);
        let is_joint = u % width < 3 || v % height < 3;
        *light += if is_joint { joint } else { shades[v / height * columns + u / width] };
    }
}

/// A label: a field of another colour with lines of text.
fn add_label(texels: &mut [[f32; 3]], rng: &mut ChaCha8Rng) {
    let field: [f32; 3] = std::array::from_fn(|_| rng.random_range(30.0..235.0));
    let ink = field.map(|c| if c > 128.0 { c - 110.0 } else { c + 110.0 });
    let [left, top] = [0, 1].map(|_| rng.random_range(0..SIDE));
    let (width, height) = (rng.random_range(14..60), rng.random_range(10..50));
    let line = rng.random_range(5..9);
    for v in 0..height {
        // Words are as long as chance makes them.
        let mut in_word = true;
        for u in 0..width {
            if rng.random_bool(0.15) {
                in_word = !in_word;
            }
            let is_text = v % line > line / 2 && in_word && (3..width - 3).contains(&u);
            let at = (top + v) % SIDE * SIDE + (left + u) % SIDE;
            texels[at] = if is_text { ink } else { field };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::scenes::scene;
    use super::*;

    /// Mean absolute difference of neighbouring texels of the thing's surfaces, grey levels.
    fn roughness(surfaces: Surfaces, name: &str) -> f64 {
        let mut scene = scene(name, 4).unwrap();
        paint(&mut scene, surfaces.texture(4), 4);
        let solids = scene.parts.iter().flat_map(|part| &part.solids);
        let steps: Vec<f64> = solids
            .flat_map(|solid| {
                let texture = solid.material.texture.clone();
                (0..400).map(move |i| {
                    let (x, y) = (0.0113 * f64::from(i), 0.0071 * f64::from(i));
                    let [a, b] = [texture.at(x, y), texture.at(x + 0.002, y)];
                    f64::from((a[1] - b[1]).abs())
                })
            })
            .collect();
        steps.iter().sum::<f64>() / steps.len() as f64
    }

    #[test]
    fn a_plain_thing_shows_far_less_than_a_speckled_one_and_keeps_its_colour() {
        assert!(
            roughness(Surfaces::Plain, "fridge") < 0.3 * roughness(Surfaces::Speckled, "fridge")
        );
        let (before, mut after) = (scene("fridge", 4).unwrap(), scene("fridge", 4).unwrap());
        paint(&mut after, Some(TextureClass::Plain), 4);
        let colours = |scene: &Scene| -> Vec<[f64; 3]> {
            let solids = scene.parts.iter().flat_map(|part| &part.solids);
            solids.map(|solid| solid.material.texture.colour).collect()
        };
        assert_eq!(colours(&before), colours(&after));
    }

    #[test]
    fn surfaces_of_a_thing_are_the_same_in_every_room() {
        let at = |seed| {
            let mut scene = scene("drawer", seed).unwrap();
            paint(&mut scene, Some(TextureClass::Plain), seed);
            scene.parts[1].solids[0].material.texture.at(0.1, 0.2)
        };
        assert_eq!(at(1), at(2));
    }

    #[test]
    fn half_of_the_things_in_a_home_are_plain_and_speckles_stay_as_they_are() {
        let textures = [0, 1, 2, 3].map(|number| Surfaces::Home.texture(number).unwrap());
        assert_eq!(textures.iter().filter(|t| **t == TextureClass::Plain).count(), 2);
        assert_eq!(Surfaces::Plain.texture(3), Some(TextureClass::Plain));
        assert_eq!(Surfaces::Speckled.texture(0), None);
    }
}
