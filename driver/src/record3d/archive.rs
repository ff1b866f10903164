//! Where the files of a recording of Record3D lie: in a `.r3d` file, which is a ZIP archive, or in a folder.

use linkage_frames::text_table;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use zip::ZipArchive;

/// The files of one recording.
pub struct Archive {
    place: Place,
    names: BTreeSet<String>,
}

enum Place {
    /// One entry is read at a time.
    Zip(Mutex<ZipArchive<BufReader<File>>>),
    Folder(PathBuf),
}

impl Archive {
    /// Opens it and lists its files.
    ///
    /// # Errors
    /// What is damaged or cannot be read.
    pub fn open(path: &Path) -> Result<Self, String> {
        if path.is_dir() {
            let names = names_in_folder(path).map_err(|e| e.to_string())?;
            return Ok(Self { place: Place::Folder(path.to_owned()), names });
        }
        let file = text_table::regular_file(path).map_err(|e| e.to_string())?;
        let zip = ZipArchive::new(BufReader::new(file))
            .map_err(|e| format!("is no recording of Record3D, which is a ZIP archive: {e}"))?;
        let names = zip.file_names().filter_map(Result::ok).map(Cow::into_owned).collect();
        Ok(Self { place: Place::Zip(Mutex::new(zip)), names })
    }

    /// Whether there is a file of this name.
    pub fn holds(&self, name: &str) -> bool {
        self.names.contains(name)
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// It is missing, damaged, or has more bytes than `most`.
    pub fn read(&self, name: &str, most: u64) -> Result<Vec<u8>, String> {
        if !self.holds(name) {
            return Err("is missing".to_owned());
        }
        let bytes = match &self.place {
            Place::Folder(dir) => {
                let file = text_table::regular_file(&dir.join(name)).map_err(|e| e.to_string())?;
                text_table::read_up_to(most, file)
            }
            Place::Zip(zip) => {
                let mut zip = zip.lock().unwrap_or_else(PoisonError::into_inner);
                text_table::read_up_to(most, zip.by_name(name).map_err(|e| e.to_string())?)
            }
        };
        bytes.map_err(|e| e.to_string())
    }

    /// Numbers of the frames that have colour and depth, in their order.
    pub fn frames(&self) -> Vec<u64> {
        let mut numbers: Vec<u64> = self.color_numbers().collect();
        numbers.retain(|number| self.holds(&super::depth_name(*number)));
        numbers.sort_unstable();
        numbers
    }

    /// How many colour pictures there are.
    pub fn pictures(&self) -> usize {
        self.color_numbers().count()
    }

    fn color_numbers(&self) -> impl Iterator<Item = u64> {
        let number = |name: &String| {
            let number = name.strip_prefix("rgbd/")?.strip_suffix(".jpg")?.parse().ok()?;
            // "007.jpg" is not what a frame's picture is called.
            (super::color_name(number) == *name).then_some(number)
        };
        self.names.iter().filter_map(number)
    }
}

fn names_in_folder(dir: &Path) -> io::Result<BTreeSet<String>> {
    let mut names = BTreeSet::new();
    for (folder, prefix) in [(dir.to_owned(), ""), (dir.join("rgbd"), "rgbd/")] {
        for entry in std::fs::read_dir(folder)? {
            if let Ok(name) = entry?.file_name().into_string() {
                names.insert(format!("{prefix}{name}"));
            }
        }
    }
    Ok(names)
}
