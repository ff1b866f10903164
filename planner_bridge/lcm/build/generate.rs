//! Writes Rust for LCM structs: a plain struct, its constants, and its codec.
//!
//! Members that only hold the length of an array are left out of the struct: the array
//! knows its length. Arrays of more than one dimension are not used here and are refused.

use super::idl::{Dimension, Member, Struct};
use std::fmt::Write;

/// Rust source of all messages, a module a package.
pub fn rust(structs: &[Struct]) -> String {
    let mut packages: Vec<&str> = structs.iter().map(|s| s.package.as_str()).collect();
    packages.sort_unstable();
    packages.dedup();
    let mut out = String::new();
    for package in packages {
        let _ = writeln!(out, "/// Messages of package `{package}`.\npub mod {package} {{");
        let _ = writeln!(
            out,
            "    use crate::codec::{{Decoder, DecodeError, EncodeError, Encoder, Field, Fingerprint, Message}};"
        );
        for s in structs.iter().filter(|s| s.package == package) {
            out.push_str(&message(s));
        }
        out.push_str("}\n");
    }
    out.push_str(&every_message(structs));
    out
}

/// A macro that hands the types of all messages to another one, for what must hold of each.
fn every_message(structs: &[Struct]) -> String {
    let types: Vec<String> = structs
        .iter()
        .map(|s| format!("$crate::messages::{}::{}", s.package, type_name(&s.name)))
        .collect();
    format!(
        "/// Calls a macro with the types of all messages.\n#[macro_export]\nmacro_rules! every_message {{\n    ($with:ident) => {{ $with! {{ {} }} }};\n}}\n",
        types.join(", ")
    )
}

fn message(s: &Struct) -> String {
    let mut out = String::new();
    let name = type_name(&s.name);
    let _ = writeln!(out, "    /// `{}.{}`: {}", s.package, s.name, s.comment);
    let _ =
        writeln!(out, "    #[derive(Debug, Clone, PartialEq, Default)]\n    pub struct {name} {{");
    for m in s.members.iter().filter(|m| !is_length(s, &m.name)) {
        let _ = writeln!(
            out,
            "        /// `{}`.\n        pub {}: {},",
            m.name,
            ident(&m.name),
            rust_type(m)
        );
    }
    out.push_str("    }\n");
    if s.members.iter().any(|m| matches!(m.dimensions.first(), Some(Dimension::Fixed(n)) if n.parse::<usize>().is_ok_and(|n| n > 32))) {
        // Default is not derived for long arrays.
        out = out.replace(", Default)]", ")]");
        let _ = writeln!(out, "    impl Default for {name} {{\n        fn default() -> Self {{\n            Self {{");
        for m in s.members.iter().filter(|m| !is_length(s, &m.name)) {
            let value = match m.dimensions.first() {
                Some(Dimension::Fixed(n)) => format!("[Default::default(); {n}]"),
                _ => "Default::default()".to_owned(),
            };
            let _ = writeln!(out, "                {}: {value},", ident(&m.name));
        }
        out.push_str("            }\n        }\n    }\n");
    }
    if !s.constants.is_empty() {
        let _ = writeln!(out, "    impl {name} {{");
        for c in &s.constants {
            let _ = writeln!(
                out,
                "        /// `{}`.\n        pub const {}: {} = {};",
                c.name,
                c.name,
                primitive(&c.kind).expect("constants are primitive"),
                c.value
            );
        }
        out.push_str("    }\n");
    }
    let _ = writeln!(out, "    impl Message for {name} {{");
    let _ = writeln!(out, "        const NAME: &'static str = \"{}.{}\";", s.package, s.name);
    out.push_str(&least_bytes(s));
    out.push_str(&fingerprint(s));
    out.push_str(&encode(s));
    out.push_str(&decode(s));
    out.push_str("    }\n");
    out
}

/// Fewest bytes of its members: arrays of variable length may be empty.
fn least_bytes(s: &Struct) -> String {
    let least = |m: &Member| {
        let one = primitive(&m.kind).map_or_else(|| path(&m.kind), str::to_owned);
        match m.dimensions.first() {
            None => Some(format!("<{one} as Field>::LEAST_BYTES")),
            Some(Dimension::Fixed(n)) => Some(format!("{n} * <{one} as Field>::LEAST_BYTES")),
            Some(Dimension::Variable(_)) => None,
        }
    };
    let sum: Vec<String> = s.members.iter().filter_map(least).collect();
    let sum = if sum.is_empty() { "0".to_owned() } else { sum.join(" + ") };
    format!("        const LEAST_BYTES: usize = {sum};\n")
}

/// The base hash of LCM, over names, primitive types and dimensions; children by content.
fn fingerprint(s: &Struct) -> String {
    let mut out = String::from(
        "        fn base_fingerprint() -> Fingerprint {\n            Fingerprint::new()\n",
    );
    for m in &s.members {
        let primitive = primitive(&m.kind).map(|_| m.kind.as_str());
        let _ = writeln!(
            out,
            "                .member({:?}, {primitive:?}, &{:?})",
            m.name,
            dimensions(m)
        );
    }
    out.push_str("        }\n");
    let children: Vec<String> =
        s.members.iter().filter(|m| primitive(&m.kind).is_none()).map(|m| path(&m.kind)).collect();
    let _ = writeln!(out, "        fn children_fingerprint() -> u64 {{");
    let sum = children.iter().fold(String::from("0_u64"), |sum, c| {
        format!("{sum}.wrapping_add(<{c} as Message>::fingerprint())")
    });
    let _ = writeln!(out, "            {sum}\n        }}");
    out
}

fn dimensions(m: &Member) -> Vec<(u8, &str)> {
    m.dimensions
        .iter()
        .map(|d| match d {
            Dimension::Fixed(n) => (0, n.as_str()),
            Dimension::Variable(n) => (1, n.as_str()),
        })
        .collect()
}

fn encode(s: &Struct) -> String {
    let mut out = String::from(
        "        fn encode_body(&self, out: &mut Encoder) -> Result<(), EncodeError> {\n",
    );
    for m in &s.members {
        let name = &ident(&m.name);
        if is_length(s, name) {
            let arrays: Vec<&str> = s
                .members
                .iter()
                .filter(
                    |a| matches!(a.dimensions.first(), Some(Dimension::Variable(n)) if n == name),
                )
                .map(|a| a.name.as_str())
                .collect();
            let first = arrays[0];
            for other in &arrays[1..] {
                let _ = writeln!(
                    out,
                    "            out.same_length(\"{first}\", self.{first}.len(), \"{other}\", self.{other}.len())?;"
                );
            }
            let kind = primitive(&m.kind).expect("a length is an integer");
            let _ = writeln!(
                out,
                "            out.put(&{kind}::try_from(self.{first}.len()).map_err(|_| out.too_long(\"{first}\", self.{first}.len()))?)?;"
            );
        } else if m.dimensions.is_empty() {
            let _ = writeln!(out, "            out.put(&self.{name})?;");
        } else {
            let _ = writeln!(out, "            out.put_all(&self.{name})?;");
        }
    }
    out.push_str("            Ok(())\n        }\n");
    out
}

fn decode(s: &Struct) -> String {
    let mut out = String::from(
        "        fn decode_body(input: &mut Decoder) -> Result<Self, DecodeError> {\n",
    );
    for m in &s.members {
        let name = &ident(&m.name);
        if is_length(s, name) {
            let kind = primitive(&m.kind).expect("a length is an integer");
            let _ = writeln!(out, "            let {name} = input.length::<{kind}>(\"{name}\")?;");
        } else {
            match m.dimensions.first() {
                None => {
                    let _ = writeln!(out, "            let {name} = input.take()?;");
                }
                Some(Dimension::Fixed(_)) => {
                    let _ = writeln!(out, "            let {name} = input.take_array()?;");
                }
                Some(Dimension::Variable(n)) => {
                    let _ = writeln!(out, "            let {name} = input.take_many({n})?;");
                }
            }
        }
    }
    let fields: Vec<String> =
        s.members.iter().filter(|m| !is_length(s, &m.name)).map(|m| ident(&m.name)).collect();
    let _ = writeln!(out, "            Ok(Self {{ {} }})\n        }}", fields.join(", "));
    out
}

fn is_length(s: &Struct, name: &str) -> bool {
    s.members
        .iter()
        .flat_map(|m| &m.dimensions)
        .any(|d| matches!(d, Dimension::Variable(n) if n == name))
}

fn rust_type(m: &Member) -> String {
    let element = primitive(&m.kind).map_or_else(|| path(&m.kind), str::to_owned);
    match m.dimensions.as_slice() {
        [] => element,
        [Dimension::Fixed(n)] => format!("[{element}; {n}]"),
        [Dimension::Variable(_)] => format!("Vec<{element}>"),
        _ => panic!("{}: arrays of several dimensions are not supported", m.name),
    }
}

fn primitive(kind: &str) -> Option<&'static str> {
    Some(match kind {
        "int8_t" => "i8",
        "int16_t" => "i16",
        "int32_t" => "i32",
        "int64_t" => "i64",
        "byte" => "u8",
        "float" => "f32",
        "double" => "f64",
        "string" => "String",
        "boolean" => "bool",
        _ => return None,
    })
}

fn path(kind: &str) -> String {
    let (package, name) = kind.split_once('.').expect("nested types are written package.struct");
    format!("crate::messages::{package}::{}", type_name(name))
}

/// `articulated_object_msg_t` becomes `ArticulatedObjectMsg`.
fn type_name(name: &str) -> String {
    name.trim_end_matches("_t")
        .split('_')
        .map(|word| {
            let (first, rest) = word.split_at(1);
            first.to_uppercase() + rest
        })
        .collect()
}

/// A member's name as Rust may write it.
fn ident(name: &str) -> String {
    if name == "type" { format!("r#{name}") } else { name.to_owned() }
}
