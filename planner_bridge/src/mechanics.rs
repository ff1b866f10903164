//! What drives joints and what resists them, as a rig gives it for exports.
//!
//! A camera does not show forces. What a rig leaves out stays `None`; the exports then write a guess
//! and say so.

use linkage_skill::object::JointKind;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Drive, damping and friction of all objects, and of some by their name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mechanics {
    /// Hinges and screws.
    pub revolute: JointMechanics,
    /// Slides.
    pub prismatic: JointMechanics,
    /// Objects by name; what one leaves out is as for all.
    pub objects: BTreeMap<String, ObjectMechanics>,
}

/// Drive, damping and friction of the joints of one object.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectMechanics {
    /// Hinges and screws.
    pub revolute: JointMechanics,
    /// Slides.
    pub prismatic: JointMechanics,
}

/// What drives a joint and what resists it, as far as it is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JointMechanics {
    /// The most that may drive it, N m or N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effort: Option<f64>,
    /// N m s/rad or N s/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Dry friction, N m or N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
}

impl Mechanics {
    /// Of a joint of an object: the object's own values over those of all.
    pub fn of(&self, object: &str, kind: JointKind) -> JointMechanics {
        let turns = matches!(kind, JointKind::Revolute | JointKind::Helical);
        let of_all = if turns { self.revolute } else { self.prismatic };
        let own = self.objects.get(object).map(|o| if turns { o.revolute } else { o.prismatic });
        let own = own.unwrap_or_default();
        JointMechanics {
            effort: own.effort.or(of_all.effort),
            damping: own.damping.or(of_all.damping),
            friction: own.friction.or(of_all.friction),
        }
    }

    /// Refuses values that no joint can have.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.revolute.check("mechanics.revolute")?;
        self.prismatic.check("mechanics.prismatic")?;
        self.objects.iter().try_for_each(|(name, own)| {
            own.revolute.check(&format!("mechanics.objects.{name}.revolute"))?;
            own.prismatic.check(&format!("mechanics.objects.{name}.prismatic"))
        })
    }
}

impl JointMechanics {
    fn check(&self, table: &str) -> Result<(), String> {
        if let Some(effort) = self.effort.filter(|x| !(x.is_finite() && *x > 0.0)) {
            return Err(format!("{table}.effort is {effort}: it must be finite and above 0"));
        }
        for (key, value) in [("damping", self.damping), ("friction", self.friction)] {
            if let Some(value) = value.filter(|x| !(x.is_finite() && *x >= 0.0)) {
                return Err(format!("{table}.{key} is {value}: it must be finite and not below 0"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Mechanics {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn an_object_s_own_values_count_more_than_those_of_all() {
        let given = read(
            "[revolute]\neffort = 40.0\ndamping = 0.3\n\
             [objects.fridge.revolute]\ndamping = 2.0\nfriction = 1.5\n",
        );
        let of = |object| given.of(object, JointKind::Revolute);
        let fridge = [of("fridge").effort, of("fridge").damping, of("fridge").friction];
        assert_eq!(fridge, [Some(40.0), Some(2.0), Some(1.5)]);
        assert_eq!((of("oven").damping, of("oven").friction), (Some(0.3), None));
        assert_eq!(given.of("fridge", JointKind::Helical), of("fridge"));
        assert_eq!(given.of("fridge", JointKind::Prismatic), JointMechanics::default());
    }

    #[test]
    fn what_no_joint_can_have_is_refused_by_name() {
        let refused = |text: &str| read(text).check().unwrap_err();
        assert!(
            refused("[prismatic]\neffort = 0.0\n").starts_with("mechanics.prismatic.effort is 0")
        );
        assert!(refused("[revolute]\nfriction = nan\n").contains("revolute.friction is NaN"));
        let of_object = refused("[objects.bin.revolute]\ndamping = -1.0\n");
        assert!(
            of_object.starts_with("mechanics.objects.bin.revolute.damping is -1"),
            "{of_object}"
        );
        assert_eq!(read("[revolute]\nfriction = 0.0\n").check(), Ok(()));
    }
}
