//! Reads LCM's interface language: `package`, `struct`, members, `const`; no comments kept.

use std::path::PathBuf;

/// Dimension of an array.
#[derive(Debug, Clone)]
pub enum Dimension {
    /// A number in the file.
    Fixed(String),
    /// The name of the member that holds the length.
    Variable(String),
}

/// A member of a struct.
#[derive(Debug, Clone)]
pub struct Member {
    pub name: String,
    /// A primitive, or `package.struct`.
    pub kind: String,
    pub dimensions: Vec<Dimension>,
}

/// A constant.
#[derive(Debug, Clone)]
pub struct Constant {
    pub name: String,
    pub kind: String,
    pub value: String,
}

/// A message.
#[derive(Debug, Clone)]
pub struct Struct {
    pub package: String,
    pub name: String,
    pub comment: String,
    pub members: Vec<Member>,
    pub constants: Vec<Constant>,
}

/// Reads all `.lcm` files of a folder, in the order of their names.
pub fn read_folder(folder: &str) -> Vec<Struct> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the folder of .lcm types exists")
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "lcm"))
        .collect();
    files.sort();
    files
        .iter()
        .map(|f| parse(&std::fs::read_to_string(f).expect("a .lcm file is readable text")))
        .collect()
}

fn parse(text: &str) -> Struct {
    let comment = text.lines().filter_map(|l| l.strip_prefix("// ")).collect::<Vec<_>>().join(" ");
    let code: String = text
        .lines()
        .map(|l| l.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join(" ");
    let (head, body) = code.split_once('{').expect("a struct has a body");
    let (package, name) = head
        .split_once(';')
        .map(|(p, s)| (p.trim().trim_start_matches("package").trim(), s))
        .expect("a file begins with its package");
    let name = name.trim().trim_start_matches("struct").trim();
    let mut result = Struct {
        package: package.to_owned(),
        name: name.to_owned(),
        comment,
        members: Vec::new(),
        constants: Vec::new(),
    };
    for statement in body.trim_end().trim_end_matches('}').split(';') {
        let statement = statement.trim();
        if let Some(constants) = statement.strip_prefix("const ") {
            let (kind, list) = constants.split_once(' ').expect("const TYPE NAME = VALUE");
            for constant in list.split(',') {
                let (name, value) = constant.split_once('=').expect("const TYPE NAME = VALUE");
                result.constants.push(Constant {
                    name: name.trim().to_owned(),
                    kind: kind.to_owned(),
                    value: value.trim().to_owned(),
                });
            }
        } else if !statement.is_empty() {
            result.members.push(parse_member(statement));
        }
    }
    result
}

fn parse_member(statement: &str) -> Member {
    let (kind, declaration) = statement.split_once(char::is_whitespace).expect("TYPE NAME");
    let mut parts = declaration.trim().split('[');
    let name = parts.next().expect("split gives at least one piece").trim().to_owned();
    let dimensions = parts
        .map(|d| {
            let size = d.trim_end_matches(']').trim().to_owned();
            if size.starts_with(|c: char| c.is_ascii_digit()) {
                Dimension::Fixed(size)
            } else {
                Dimension::Variable(size)
            }
        })
        .collect();
    Member { name, kind: kind.to_owned(), dimensions }
}
