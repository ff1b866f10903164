//! Names that a format can hold: those that it keeps for itself are changed, and none comes twice.

use super::description::Description;
use std::collections::HashSet;

/// The same object with names that follow a format's rule; `taken` are names that the file uses.
pub fn legal(of: &Description, rule: fn(&str) -> String, taken: &[&str]) -> Description {
    let mut used: HashSet<String> = taken.iter().map(|name| (*name).to_owned()).collect();
    let mut renamed = |name: &str| {
        let wanted = rule(name);
        let numbered = (2..).map(|i| format!("{wanted}_{i}"));
        let mut all = std::iter::once(wanted.clone()).chain(numbered);
        let free = all.find(|name| !used.contains(name)).unwrap_or(wanted.clone());
        used.insert(free.clone());
        free
    };
    let mut legal = of.clone();
    legal.name = rule(&of.name);
    legal.links.iter_mut().for_each(|link| link.name = renamed(&link.name));
    legal.joints.iter_mut().for_each(|joint| joint.name = renamed(&joint.name));
    legal
}

/// Names of URDF and MJCF: `world` is what all stands on.
pub fn plain(name: &str) -> String {
    if name == "world" { "world_".to_owned() } else { name.to_owned() }
}

/// Names of SDF: `::` divides scopes, and what begins and ends with two underscores is reserved.
pub fn sdf(name: &str) -> String {
    let name = plain(name).replace("::", "_");
    let is_reserved = name.starts_with("__") && name.ends_with("__");
    if is_reserved { format!("_{}", name.trim_matches('_')) } else { name }
}

/// Names of USD: letters, digits and underscores, no digit first.
pub fn usd(name: &str) -> String {
    let allowed = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = name.chars().map(allowed).collect();
    if name.starts_with(|c: char| c.is_ascii_digit()) { format!("_{name}") } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reserved_names_are_changed_in_each_format() {
        assert_eq!(plain("world"), "world_");
        assert_eq!(sdf("world"), "world_");
        assert_eq!(sdf("__model__"), "_model");
        assert_eq!(sdf("shelf::door"), "shelf_door");
        assert_eq!(usd("2nd door, left"), "_2nd_door__left");
        assert_eq!(plain("cup & board"), "cup & board");
    }
}
