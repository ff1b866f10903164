//! Pairs of numbered pictures: `color/000017.jpg` and `depth/000017.png`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most pictures of a folder: some hours.
const MAX_PICTURES: usize = 1_000_000;

/// A colour picture and the depth picture of its number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NumberedPair {
    /// The number in their names; the place in order where names have none in common.
    pub number: u64,
    /// Colour.
    pub color: PathBuf,
    /// Depth.
    pub depth: PathBuf,
}

/// Which files are pictures of one kind.
pub struct Pictures<'p> {
    /// The folder.
    pub dir: &'p Path,
    /// Ends of their names, in small letters.
    pub endings: &'p [&'p str],
}

/// All pairs, by number, and how many colour pictures have no depth.
///
/// # Errors
/// What is missing, in a line.
pub fn pairs(
    colors: &Pictures<'_>,
    depths: &Pictures<'_>,
) -> Result<(Vec<NumberedPair>, usize), String> {
    let (colors, depths) = (files(colors)?, files(depths)?);
    let numbered = |files: &[PathBuf]| -> BTreeMap<u64, PathBuf> {
        files.iter().filter_map(|f| Some((number_of(f)?, f.clone()))).collect()
    };
    let (by_number, depth_by_number) = (numbered(&colors), numbered(&depths));
    let has_numbers = by_number.len() == colors.len() && depth_by_number.len() == depths.len();
    let pairs: Vec<NumberedPair> = by_number
        .iter()
        .filter_map(|(&number, color)| {
            let (color, depth) = (color.clone(), depth_by_number.get(&number)?.clone());
            Some(NumberedPair { number, color, depth })
        })
        .collect();
    if has_numbers && !pairs.is_empty() {
        let alone = colors.len() - pairs.len();
        return Ok((pairs, alone));
    }
    if colors.len() != depths.len() {
        return Err(format!(
            "{} colour pictures and {} depth pictures have no numbers in common in their names",
            colors.len(),
            depths.len()
        ));
    }
    let in_order = colors.into_iter().zip(depths).zip(0..);
    let pair = |((color, depth), number)| NumberedPair { number, color, depth };
    Ok((in_order.map(pair).collect(), 0))
}

/// Files of a folder with one of these endings, in the order of their names.
fn files(pictures: &Pictures<'_>) -> Result<Vec<PathBuf>, String> {
    let at = |reason: String| format!("{}: {reason}", pictures.dir.display());
    let entries = std::fs::read_dir(pictures.dir).map_err(|e| at(e.to_string()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| at(e.to_string()))?.path();
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let name = name.to_ascii_lowercase();
        if pictures.endings.iter().any(|ending| name.ends_with(ending)) && path.is_file() {
            files.push(path);
        }
        if files.len() > MAX_PICTURES {
            return Err(at(format!("more than {MAX_PICTURES} pictures")));
        }
    }
    if files.is_empty() {
        return Err(at(format!("no picture whose name ends in {}", pictures.endings.join(", "))));
    }
    files.sort();
    Ok(files)
}

/// The first number in a name: 17 of `frame-000017.color.png`.
fn number_of(path: &Path) -> Option<u64> {
    let name = path.file_name()?.to_str()?;
    let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    digits[..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(names: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        names.iter().for_each(|name| std::fs::write(dir.path().join(name), "").unwrap());
        dir
    }

    fn numbers(colors: &[&str], depths: &[&str]) -> Result<(Vec<u64>, usize), String> {
        let (colors, depths) = (folder(colors), folder(depths));
        let color = Pictures { dir: colors.path(), endings: &[".jpg", ".png"] };
        let depth = Pictures { dir: depths.path(), endings: &[".png"] };
        pairs(&color, &depth).map(|(p, alone)| (p.iter().map(|p| p.number).collect(), alone))
    }

    #[test]
    fn pictures_are_paired_by_their_numbers_not_by_their_order() {
        let found = numbers(&["2.jpg", "10.jpg", "11.jpg"], &["0002.png", "0011.png"]).unwrap();
        assert_eq!(found, (vec![2, 11], 1));
        let found = numbers(&["frame-000003.color.jpg"], &["frame-000003.depth.png"]).unwrap();
        assert_eq!(found, (vec![3], 0));
    }

    #[test]
    fn names_without_numbers_in_common_are_paired_by_their_order() {
        let found = numbers(&["1.5.png", "1.6.png"], &["1.51.png", "1.62.png"]).unwrap();
        assert_eq!(found, (vec![0, 1], 0));
        let error = numbers(&["5.png", "6.png"], &["7.png"]).unwrap_err();
        assert!(error.contains("2 colour pictures and 1 depth"), "{error}");
        assert!(numbers(&["a.txt"], &["7.png"]).unwrap_err().contains(".jpg, .png"));
    }
}
