//! The layout rule of the repository: there are no import cycles, neither among files nor among the
//! folders of a package.
//!
//! In: the source files of every package of the repository. Out: a failure that lists the cycles, if
//! there are any. A cycle is a set of files of one package of which each imports every other one,
//! directly or through others: a strongly connected component of the graph of `use` lines. The files of
//! a cycle can neither be read nor be tested one after the other. A folder that lies directly in `src`
//! imports what any of its files imports.
//!
//! What counts: `use` lines that begin with `crate`, `self`, `super` or the name of a child module,
//! in tests too. What does not: `mod` lines, and paths that stand in the middle of code. A `mod.rs`
//! is the file of its folder.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A module of a package: the names that lead to it from the package's root.
type ModulePath = Vec<String>;

/// Files by module.
type Files = BTreeMap<ModulePath, PathBuf>;

/// The files that each file imports.
type Imports = BTreeMap<PathBuf, BTreeSet<PathBuf>>;

#[test]
fn no_file_imports_a_file_that_imports_it() {
    assert_none("files", cycles_of_repository(|imports, _| imports));
}

#[test]
fn no_folder_imports_a_folder_that_imports_it() {
    assert_none("folders", cycles_of_repository(of_folders));
}

fn assert_none(what: &str, cycles: BTreeSet<Vec<String>>) {
    let listed: String =
        cycles.iter().map(|files| format!("\n  {}", files.join("\n    "))).collect();
    assert!(cycles.is_empty(), "{what} that import each other in a cycle:{listed}");
}

/// The cycles of all packages of the repository among what `grouped` makes of their imports.
fn cycles_of_repository(grouped: fn(Imports, &Path) -> Imports) -> BTreeSet<Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ has a parent");
    let shown = |file: &PathBuf| {
        let inside = file.strip_prefix(root).expect("the file lies in the repository");
        inside.display().to_string()
    };
    let cycles = source_folders(root).into_iter().flat_map(|source| {
        components(&grouped(imports_in(&source), &source)).into_iter().filter(is_cycle)
    });
    cycles.map(|cycle| cycle.iter().map(shown).collect()).collect()
}

/// The imports of the folders and files that lie directly in `src`; those of the package's root, which names all
/// of them, are left out.
fn of_folders(imports: Imports, source: &Path) -> Imports {
    let folder_of = |file: &Path| {
        let inside = file.strip_prefix(source).expect("the file lies in its package");
        let first = inside.iter().next().expect("a file has a name");
        let is_root = ["lib.rs", "main.rs"].iter().any(|root| first == *root);
        (!is_root).then(|| source.join(first))
    };
    let mut folders = Imports::new();
    for (file, imported) in &imports {
        let Some(folder) = folder_of(file) else { continue };
        let others = imported.iter().filter_map(|other| folder_of(other));
        let others: Vec<PathBuf> = others.filter(|other| *other != folder).collect();
        folders.entry(folder).or_default().extend(others);
    }
    folders
}

/// Folders `src` of all packages below a folder.
fn source_folders(root: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for folder in entries(root).into_iter().filter(|entry| entry.is_dir()) {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name == "src" && root.join("Cargo.toml").is_file() {
            found.push(folder);
        } else if name != "target" && !name.starts_with('.') {
            found.extend(source_folders(&folder));
        }
    }
    found
}

/// What a folder holds, in alphabetical order.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(read) = fs::read_dir(folder) else { return Vec::new() };
    let mut entries: Vec<PathBuf> = read.filter_map(|entry| Some(entry.ok()?.path())).collect();
    entries.sort();
    entries
}

/// What each file of one folder `src` imports.
fn imports_in(source: &Path) -> Imports {
    let mut files = Files::new();
    add_files(source, &ModulePath::new(), &mut files);
    let mut imports = Imports::new();
    for (module, file) in &files {
        let text = fs::read_to_string(file).expect("a source file is text");
        let imported = imported_modules(&text, module, &files);
        let others = imported.iter().filter_map(|path| file_of(path, &files));
        // What tests look at is made of what they test.
        let others = others.filter(|other| *other != file && !other.ends_with("test_data.rs"));
        let others = others.cloned();
        imports.entry(file.clone()).or_default().extend(others);
    }
    imports
}

fn is_cycle(component: &BTreeSet<PathBuf>) -> bool {
    component.len() > 1
}

/// Adds the modules of a folder, which is itself the module `path`.
fn add_files(folder: &Path, path: &ModulePath, files: &mut Files) {
    for entry in entries(folder) {
        let stem = entry.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut module = path.clone();
        if entry.is_dir() {
            module.push(stem);
            add_files(&entry, &module, files);
        } else if entry.extension().is_some_and(|extension| extension == "rs") {
            if stem != "mod" && !(path.is_empty() && (stem == "lib" || stem == "main")) {
                module.push(stem);
            }
            files.insert(module, entry);
        }
    }
}

/// The file in which a path ends: that of the longest part of it that is a module with a file.
fn file_of<'f>(path: &[String], files: &'f Files) -> Option<&'f PathBuf> {
    (0..=path.len()).rev().find_map(|length| files.get(&path[..length]))
}

/// Paths, from the package's root, that the `use` lines of a module's text import.
fn imported_modules(text: &str, module: &ModulePath, files: &Files) -> Vec<ModulePath> {
    let tokens = tokens(text);
    let mut imported = Vec::new();
    // Modules within the file that are open at a token, each with the depth of its braces.
    let mut inner: Vec<(usize, String)> = Vec::new();
    let mut depth = 0;
    let mut i = 0;
    while i < tokens.len() {
        match tokens[i].as_str() {
            "{" => depth += 1,
            "}" => {
                depth -= 1;
                inner.retain(|(opened_at, _)| *opened_at <= depth);
            }
            "mod" if tokens.get(i + 2).is_some_and(|next| next == "{") => {
                inner.push((depth + 1, tokens[i + 1].clone()));
            }
            "use" if tokens.get(i + 1).is_some_and(|next| next != "<") => {
                let mut here = module.clone();
                here.extend(inner.iter().map(|(_, name)| name.clone()));
                let mut paths = Vec::new();
                i = read_use_tree(&tokens, i + 1, &Vec::new(), &mut paths);
                imported.extend(paths.iter().filter_map(|path| from_root(path, &here, files)));
            }
            _ => {}
        }
        i += 1;
    }
    imported
}

/// Reads a use tree that begins at a token; adds its paths, each after `prefix`. Returns where the
/// tree ends.
fn read_use_tree(
    tokens: &[String],
    start: usize,
    prefix: &ModulePath,
    paths: &mut Vec<ModulePath>,
) -> usize {
    let mut path = prefix.clone();
    let mut i = start;
    while i < tokens.len() {
        match tokens[i].as_str() {
            "," | ";" | "}" => break,
            ":" => {}
            // The name that follows is a new one.
            "as" => i += 1,
            "{" => {
                while tokens.get(i).is_some_and(|token| token == "{" || token == ",") {
                    i = read_use_tree(tokens, i + 1, &path, paths);
                }
                return i + 1;
            }
            name => path.push(name.to_owned()),
        }
        i += 1;
    }
    if path.len() > prefix.len() {
        paths.push(path);
    }
    i
}

/// A path as it stands in the module `here`, from the package's root; `None` for another package's.
fn from_root(path: &[String], here: &[String], files: &Files) -> Option<ModulePath> {
    let (first, rest) = path.split_first()?;
    let mut from_root = match first.as_str() {
        "crate" => ModulePath::new(),
        "self" => here.to_vec(),
        "super" => here.split_last()?.1.to_vec(),
        child => {
            let mut module = here.to_vec();
            module.push(child.to_owned());
            files.contains_key(&module).then_some(module)?
        }
    };
    for name in rest {
        match name.as_str() {
            "super" => drop(from_root.pop()),
            "self" => {}
            name => from_root.push(name.to_owned()),
        }
    }
    Some(from_root)
}

/// Words and single signs of a text, without its comments, strings and characters.
fn tokens(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let rest = &chars[i..];
        let raw = raw_string_length(rest);
        if rest.starts_with(&['/', '/']) {
            i += rest.iter().position(|c| *c == '\n').unwrap_or(rest.len());
        } else if rest.starts_with(&['/', '*']) {
            let end = rest.windows(2).position(|pair| pair == ['*', '/']);
            i += end.map_or(rest.len(), |end| end + 2);
        } else if raw > 0 {
            i += raw;
        } else if rest[0] == '"' {
            i += quoted_length(rest, '"');
        } else if rest[0] == '\'' && (rest.get(1) == Some(&'\\') || rest.get(2) == Some(&'\'')) {
            i += quoted_length(rest, '\'');
        } else if rest[0].is_alphanumeric() || rest[0] == '_' {
            let end = rest.iter().position(|c| !c.is_alphanumeric() && *c != '_');
            let word: String = rest[..end.unwrap_or(rest.len())].iter().collect();
            i += word.chars().count();
            tokens.push(word);
        } else {
            if !rest[0].is_whitespace() {
                tokens.push(rest[0].to_string());
            }
            i += 1;
        }
    }
    tokens
}

/// Characters of a raw string at the beginning of a text; 0 where there is none.
fn raw_string_length(text: &[char]) -> usize {
    if text[0] != 'r' {
        return 0;
    }
    let hashes = text[1..].iter().take_while(|c| **c == '#').count();
    if text.get(1 + hashes) != Some(&'"') {
        return 0;
    }
    let closing: Vec<char> = std::iter::once('"').chain(std::iter::repeat_n('#', hashes)).collect();
    let inside = &text[2 + hashes..];
    let end = inside.windows(closing.len()).position(|window| window == closing);
    end.map_or(text.len(), |end| 2 + hashes + end + closing.len())
}

/// Characters of a string or character at the beginning of a text, with its two quotes.
fn quoted_length(text: &[char], quote: char) -> usize {
    let mut i = 1;
    while i < text.len() && text[i] != quote {
        i += if text[i] == '\\' { 2 } else { 1 };
    }
    i + 1
}

/// Strongly connected components of the imports: the files that reach each other. By the sets that
/// each file reaches; the packages here have some hundred files at the most.
fn components(imports: &Imports) -> Vec<BTreeSet<PathBuf>> {
    let reached: BTreeMap<&PathBuf, BTreeSet<&PathBuf>> =
        imports.keys().map(|file| (file, reached_from(file, imports))).collect();
    let component_of = |file: &PathBuf| -> BTreeSet<PathBuf> {
        let reach_each_other =
            |other: &&&PathBuf| reached[file].contains(**other) && reached[**other].contains(file);
        let others = reached.keys().filter(reach_each_other).map(|other| (*other).clone());
        std::iter::once(file.clone()).chain(others).collect()
    };
    let all: BTreeSet<BTreeSet<PathBuf>> = imports.keys().map(component_of).collect();
    all.into_iter().collect()
}

/// The files that a file imports, directly or through others.
fn reached_from<'i>(file: &PathBuf, imports: &'i Imports) -> BTreeSet<&'i PathBuf> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&PathBuf> = imports[file].iter().collect();
    while let Some(next) = open.pop() {
        if reached.insert(next) {
            open.extend(&imports[next]);
        }
    }
    reached
}

/// A synthetic package: the cycles among its files, by their paths in `src`.
fn cycles_of(made_up: &[(&str, &str)]) -> Vec<Vec<String>> {
    cycles_among(made_up, |imports, _| imports)
}

/// A synthetic package: the cycles among what `grouped` makes of its imports, by paths in `src`.
fn cycles_among(
    made_up: &[(&str, &str)],
    grouped: fn(Imports, &Path) -> Imports,
) -> Vec<Vec<String>> {
    let folder = tempfile::tempdir().unwrap();
    for (path, text) in made_up {
        let file = folder.path().join(path);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }
    let inside = |file: &PathBuf| file.strip_prefix(folder.path()).unwrap().display().to_string();
    let cycles = components(&grouped(imports_in(folder.path()), folder.path()));
    let cycles = cycles.iter().filter(|component| is_cycle(component));
    cycles.map(|cycle| cycle.iter().map(inside).collect()).collect()
}

#[test]
fn a_cycle_is_found_through_crate_super_self_and_child_paths() {
    let through = |of_drawer: &str, of_handle: &str| {
        cycles_of(&[
            ("lib.rs", "mod kitchen;\n"),
            ("kitchen/mod.rs", "mod drawer; mod handle; pub struct Kitchen;"),
            ("kitchen/drawer.rs", of_drawer),
            ("kitchen/handle.rs", of_handle),
        ])
    };
    let both = vec![vec!["kitchen/drawer.rs".to_owned(), "kitchen/handle.rs".to_owned()]];
    assert_eq!(through("use super::handle::Handle;", "use crate::kitchen::drawer::Drawer;"), both);
    let grouped = "use crate::{kitchen::{Kitchen, handle::{self, Handle as Knob}}};";
    assert_eq!(through(grouped, "use super::drawer::Drawer;"), both);
    let in_tests = "mod tests { use super::*; use super::super::handle::Handle; }";
    assert_eq!(through(in_tests, "use super::drawer::*;"), both);
    // One way is no cycle, nor is what stands in a comment or in a string.
    assert!(through("use super::handle::Handle;", "").is_empty());
    let no_import = "// use super::drawer::A;\nconst A: &str = \"use super::drawer::A;\";";
    assert!(through("use super::handle::Handle;", no_import).is_empty());
}

#[test]
fn a_folder_and_a_file_in_it_may_not_import_each_other() {
    let with = |of_folder: &str| {
        cycles_of(&[
            ("main.rs", "mod kitchen; use kitchen::Kitchen;"),
            ("kitchen/mod.rs", of_folder),
            ("kitchen/drawer.rs", "use super::Kitchen;"),
        ])
    };
    let both = vec![vec!["kitchen/drawer.rs".to_owned(), "kitchen/mod.rs".to_owned()]];
    assert_eq!(with("mod drawer; pub use drawer::Drawer;"), both);
    assert_eq!(with("mod drawer; use self::drawer::Drawer;"), both);
    assert!(with("mod drawer; pub struct Kitchen;").is_empty());
}

#[test]
fn a_cycle_of_three_files_is_one_cycle() {
    let cycles = cycles_of(&[
        ("lib.rs", "mod a; mod b; mod c;"),
        ("a.rs", "use crate::b::B;"),
        ("b.rs", "use crate::c::C;"),
        ("c.rs", "use crate::a::A;"),
    ]);
    assert_eq!(cycles, [["a.rs", "b.rs", "c.rs"]]);
}

#[test]
fn folders_may_not_import_each_other_though_their_files_do_not() {
    let kitchen = [
        ("lib.rs", "mod kitchen; mod hall; pub use kitchen::drawer::Drawer;"),
        ("kitchen/mod.rs", "mod drawer; mod handle;"),
        ("kitchen/drawer.rs", "use crate::hall::door::Door;"),
        ("kitchen/handle.rs", ""),
        ("hall/mod.rs", "mod door; mod bell;"),
        ("hall/door.rs", ""),
    ];
    let with = |of_bell| {
        let all: Vec<_> = kitchen.into_iter().chain([("hall/bell.rs", of_bell)]).collect();
        (cycles_of(&all), cycles_among(&all, of_folders))
    };
    assert_eq!(with(""), (vec![], vec![]));
    let (files, folders) = with("use crate::kitchen::handle::Handle;");
    assert!(files.is_empty());
    assert_eq!(folders, [["hall", "kitchen"]]);
}
