//! Descriptions in files: RON (Rusty Object Notation).

use crate::check::check;
use crate::{Error, Photographs, Result, SCENE_VERSION, Scene};
use gs_scene::write_atomically;
use ron::extensions::Extensions;
use ron::ser::PrettyConfig;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// What is there may be written without `Some`.
fn dialect() -> ron::Options {
    ron::Options::default().with_default_extension(Extensions::IMPLICIT_SOME)
}

/// Reads and checks a description.
///
/// # Errors
/// If the file cannot be read, is not RON or no scene (with line and column), has another version than
/// [`SCENE_VERSION`], or breaks a rule; each names the file.
pub fn read_scene(path: &Path) -> Result<Scene> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let text = std::fs::read_to_string(path).map_err(io)?;
    let broken = |problem| Error::Description { path: path.to_path_buf(), problem: Box::new(problem) };
    Scene::from_ron(&text).map_err(broken)
}

/// Reads how to photograph a scene: the RON of [`Photographs`] alone.
///
/// # Errors
/// If the file cannot be read, or is not RON or no [`Photographs`] (with line and column). Its numbers are checked when the first
/// picture is taken.
pub fn read_photographs(path: &Path) -> Result<Photographs> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let text = std::fs::read_to_string(path).map_err(io)?;
    let broken = |problem| Error::Description { path: path.to_path_buf(), problem: Box::new(problem) };
    parse(&text).map_err(broken)
}

/// Reads a value; what is wrong is told with line and column.
fn parse<T: DeserializeOwned>(text: &str) -> Result<T> {
    dialect().from_str(text).map_err(|error| Error::Syntax {
        line: error.span.start.line,
        column: error.span.start.col,
        reason: Box::new(error.code),
    })
}

/// Writes a description as [`read_scene`] reads it.
///
/// # Errors
/// If the file cannot be written.
pub fn write_scene(path: &Path, scene: &Scene) -> Result<()> {
    Ok(write_atomically(path, |out| writeln!(out, "{}", scene.to_ron()))?)
}

impl Scene {
    /// Reads and checks a description.
    ///
    /// # Errors
    /// If the text is not RON or no scene (with line and column), has another version than [`SCENE_VERSION`], or
    /// breaks a rule.
    pub fn from_ron(text: &str) -> Result<Self> {
        /// The version of any description, whatever else it holds.
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        // Another version may have other fields: it is told first.
        if let Ok(Versioned { version }) = dialect().from_str(text)
            && version != SCENE_VERSION
        {
            return Err(Error::Version { found: version, expected: SCENE_VERSION });
        }
        let scene = parse(text)?;
        check(&scene)?;
        Ok(scene)
    }

    /// The description as text that [`Scene::from_ron`] reads.
    ///
    /// # Panics
    /// Never: plain data has a form as text.
    #[must_use]
    pub fn to_ron(&self) -> String {
        // Deeper levels stand on one line.
        let style = PrettyConfig::new().new_line("\n").depth_limit(4).compact_arrays(true);
        dialect().to_string_pretty(self, style).expect("plain data has a form as text")
    }
}
