//! Points of a PLY file: position and colour of its vertices, whatever else they have; text or binary.

use crate::files::{Lines, broken, open, unreadable};
use crate::{Error, FormatRule, Place, Result, ScenePoint};
use glam::DVec3;
use gs_scene::{PlyEncoding, PlyHeader, PlyRule};
use std::io::{BufReader, Read};
use std::path::Path;

/// Reads the vertices. They must be the first element, and have x, y and z; red, green and blue are taken if there are
/// all three.
pub(crate) fn read_points(path: &Path) -> Result<Vec<ScenePoint>> {
    let unread = unreadable(path);
    let rule = |rule: PlyRule| broken(path, rule.into());
    let mut body = BufReader::new(open(path).map_err(&unread)?);
    let header = PlyHeader::read(&mut body).map_err(&unread)?.map_err(rule)?;
    // What follows the vertices is not read.
    let vertices = header.elements.first().filter(|element| element.name == "vertex");
    let vertices = vertices.ok_or_else(|| rule(PlyRule::NoVertex))?;
    let kinds = vertices.scalars().map_err(rule)?;
    let place = |name: &str| vertices.column(name);
    let coordinate = |name| place(name).ok_or_else(|| broken(path, FormatRule::NoProperty { name }));
    let position = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
    let colour = [place("red"), place("green"), place("blue")];
    let point = |values: &[f64]| {
        let xyz = position.map(|i| values[i]);
        if let Some(&found) = xyz.iter().find(|value| !value.is_finite()) {
            return Err(FormatRule::NotFinite { what: "position of a point", found });
        }
        let rgb = match colour {
            [Some(r), Some(g), Some(b)] => Some([values[r], values[g], values[b]]),
            _ => None,
        };
        if let Some(found) = rgb.and_then(|rgb| rgb.into_iter().find(|v| !(0.0..=255.0).contains(v))) {
            return Err(FormatRule::Colour { found });
        }
        Ok(ScenePoint {
            position: DVec3::from(xyz),
            colour: rgb.map(|rgb| rgb.map(|value| value as u8)),
            error: None,
            observations: Vec::new(),
        })
    };

    let mut points = Vec::new();
    let mut values = vec![0.0; kinds.len()];
    if header.encoding == PlyEncoding::Ascii {
        let mut lines = Lines::behind(path, body, header.lines as usize);
        for _ in 0..vertices.count {
            let Some(line) = lines.next_line()? else {
                let (what, wanted) = ("a vertex", kinds.len() as u64);
                return Err(broken(path, FormatRule::Cut { what, wanted, held: 0 }));
            };
            let words: Vec<&str> = line.words().collect();
            if words.len() != values.len() {
                let expected = "as many numbers as the vertex has properties";
                return Err(line.broken(FormatRule::Words { expected, found: words.len() }));
            }
            for (value, word) in values.iter_mut().zip(words) {
                *value = line.parsed("a property", word, "a number")?;
            }
            points.push(point(&values).map_err(|rule| line.broken(rule))?);
        }
        return Ok(points);
    }
    let stride: usize = kinds.iter().map(|kind| kind.size()).sum();
    let length = body.get_ref().metadata().map_err(&unread)?.len();
    let most = length.saturating_sub(header.bytes) / (stride as u64).max(1);
    if vertices.count > most {
        return Err(broken(path, FormatRule::Count { what: "vertices", found: vertices.count, most }));
    }
    for index in 0..vertices.count {
        for (value, kind) in values.iter_mut().zip(&kinds) {
            let mut bytes = [0; 8];
            let number = &mut bytes[..kind.size()];
            body.read_exact(number).map_err(&unread)?;
            if header.encoding == PlyEncoding::BigEndian {
                number.reverse();
            }
            *value = kind.decode(bytes);
        }
        let place = Place::Byte(header.bytes + index * stride as u64);
        let broken = |rule| Error::Format { path: path.to_path_buf(), place, rule };
        points.push(point(&values).map_err(broken)?);
    }
    Ok(points)
}
