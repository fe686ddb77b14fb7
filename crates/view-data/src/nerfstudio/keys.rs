//! Typed access to the keys of a JSON object, with errors that name file, frame and key.

use super::MAX_SIDE;
use crate::{Error, Result, TransformsRule as Rule};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::path::Path;

/// Parses JSON, with Python's `NaN`, `Infinity` and `-Infinity` let through as strings so that the error about them
/// can name the frame. A byte-order mark is skipped.
pub(crate) fn parse(text: &[u8]) -> serde_json::Result<Value> {
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    serde_json::from_slice(&quote_non_finite(text))
}

/// Numbers that Python's `json` writes and JSON does not have.
const NON_FINITE: [&str; 3] = ["NaN", "Infinity", "-Infinity"];

fn quote_non_finite(text: &[u8]) -> Cow<'_, [u8]> {
    let mut quoted: Vec<u8> = Vec::new();
    let mut copied = 0;
    let (mut index, mut in_string) = (0, false);
    while index < text.len() {
        match text[index] {
            b'"' => in_string = !in_string,
            b'\\' if in_string => index += 1,
            b'N' | b'I' | b'-' if !in_string => {
                if let Some(word) = NON_FINITE.iter().find(|word| text[index..].starts_with(word.as_bytes()))
                {
                    quoted.extend_from_slice(&text[copied..index]);
                    quoted.extend_from_slice(format!("\"{word}\"").as_bytes());
                    index += word.len();
                    copied = index;
                    continue;
                }
            }
            _ => {}
        }
        index += 1;
    }
    if copied == 0 {
        return Cow::Borrowed(text);
    }
    quoted.extend_from_slice(&text[copied..]);
    Cow::Owned(quoted)
}

/// A JSON object of a file, and the frame it describes. A key whose value is null counts as absent.
#[derive(Clone)]
pub(crate) struct Keys<'a> {
    file: &'a Path,
    frame: Option<String>,
    map: &'a Map<String, Value>,
}

impl<'a> Keys<'a> {
    pub(crate) fn new(file: &'a Path, frame: Option<String>, value: &'a Value) -> Result<Self> {
        match value {
            Value::Object(map) => Ok(Self { file, frame, map }),
            other => {
                let key = if frame.is_some() { "the frame" } else { "the file's content" }.to_owned();
                let rule = Rule::Type { key, expected: "an object", found: type_name(other) };
                Err(Error::Transforms { path: file.to_path_buf(), frame, rule })
            }
        }
    }

    pub(crate) fn broken(&self, rule: Rule) -> Error {
        Error::Transforms { path: self.file.to_path_buf(), frame: self.frame.clone(), rule }
    }

    pub(crate) fn wrong_type(&self, key: &str, expected: &'static str, found: &Value) -> Error {
        self.broken(Rule::Type { key: key.to_owned(), expected, found: type_name(found) })
    }

    pub(crate) fn require(
        &self,
        holds: bool,
        key: &'static str,
        found: f64,
        expected: &'static str,
    ) -> Result<()> {
        if holds { Ok(()) } else { Err(self.broken(Rule::Range { key, found, expected })) }
    }

    /// The frame's position and `file_path`.
    pub(crate) fn label(&self) -> &str {
        self.frame.as_deref().unwrap_or_default()
    }

    fn value(&self, key: &str) -> Option<&'a Value> {
        self.map.get(key).filter(|value| !value.is_null())
    }

    pub(crate) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    pub(crate) fn object(&self, key: &str) -> Result<Option<Self>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        let map = value.as_object().ok_or_else(|| self.wrong_type(key, "an object", value))?;
        Ok(Some(Self { map, ..self.clone() }))
    }

    pub(crate) fn list(&self, key: &str) -> Result<Option<&'a [Value]>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        Ok(Some(value.as_array().ok_or_else(|| self.wrong_type(key, "a list", value))?))
    }

    pub(crate) fn text(&self, key: &str) -> Result<Option<&'a str>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        Ok(Some(value.as_str().ok_or_else(|| self.wrong_type(key, "a string", value))?))
    }

    pub(crate) fn flag(&self, key: &str) -> Result<Option<bool>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        Ok(Some(value.as_bool().ok_or_else(|| self.wrong_type(key, "true or false", value))?))
    }

    /// A finite number.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>> {
        self.value(key).map(|value| self.as_number(key, value)).transpose()
    }

    fn as_number(&self, key: &str, value: &Value) -> Result<f64> {
        let number = match value {
            Value::String(word) if NON_FINITE.contains(&word.as_str()) => Some(f64::NAN),
            other => other.as_f64(),
        };
        let number = number.ok_or_else(|| self.wrong_type(key, "a number", value))?;
        if !number.is_finite() {
            return Err(self.broken(Rule::NotFinite { key: key.to_owned() }));
        }
        Ok(number)
    }

    /// The side of a picture, pixels.
    pub(crate) fn side(&self, key: &'static str, found: f64) -> Result<usize> {
        if !(found >= 1.0 && found <= MAX_SIDE as f64 && found.fract() == 0.0) {
            return Err(self.broken(Rule::Side { key, found }));
        }
        Ok(found as usize)
    }

    /// A 4×4 or 3×4 matrix, row by row, as an affine map.
    pub(crate) fn matrix(&self, key: &'static str) -> Result<Option<DAffine3>> {
        let Some(rows) = self.list(key)? else { return Ok(None) };
        let shape = |found| self.broken(Rule::MatrixShape { key, found });
        if rows.len() != 4 && rows.len() != 3 {
            return Err(shape(format!("{} rows", rows.len())));
        }
        let mut matrix = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (row, values) in matrix.iter_mut().zip(rows) {
            let values = values.as_array().ok_or_else(|| self.wrong_type(key, "a list of lists", values))?;
            if values.len() != 4 {
                return Err(shape(format!("a row of {} numbers", values.len())));
            }
            for (entry, value) in row.iter_mut().zip(values) {
                *entry = self.as_number(key, value)?;
            }
        }
        if matrix[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.broken(Rule::LastRow { key, found: matrix[3] }));
        }
        let column = |c: usize| DVec3::new(matrix[0][c], matrix[1][c], matrix[2][c]);
        let linear = DMat3::from_cols(column(0), column(1), column(2));
        Ok(Some(DAffine3::from_mat3_translation(linear, column(3))))
    }
}

fn type_name(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_bare_words_are_quoted() {
        let text = br#"{"NaN": [NaN, -Infinity, -1.5, Infinity], "a\"NaN": "x -Infinity \\"}"#;
        let expected = br#"{"NaN": ["NaN", "-Infinity", -1.5, "Infinity"], "a\"NaN": "x -Infinity \\"}"#;
        assert_eq!(quote_non_finite(text).as_ref(), expected.as_slice());
        assert!(matches!(quote_non_finite(b"[-1, null]"), Cow::Borrowed(_)));
        for cut in 0..text.len() {
            assert!(parse(&text[..cut]).is_err(), "{cut}");
        }
    }
}
