//! Safetensors, read with a check that the library leaves out, and written.

use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorView, serialize};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};

/// Why bytes are no safetensors.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SafetensorsFault {
    /// Not what the format asks for.
    #[error(transparent)]
    Unsound(#[from] SafeTensorError),
    /// The header is not understood.
    #[error("the header cannot be understood")]
    Header(#[source] serde_json::Error),
    /// The header lists data that are not there.
    #[error(
        "{name} ends at byte {end} of the data, of which there are {found}: the file is cut short or damaged"
    )]
    Truncated {
        /// Which tensor.
        name: String,
        /// Where its data should end.
        end: u64,
        /// Bytes after the header.
        found: u64,
    },
}

/// Safetensors in memory whose header agrees with the data.
pub struct Checked<'a> {
    /// The tensors.
    pub tensors: SafeTensors<'a>,
    /// The header.
    pub metadata: Metadata,
    /// Where the data begin, bytes.
    pub start: usize,
}

/// Where the data of a tensor lie, as the header has it; all else is ignored.
#[derive(Deserialize)]
struct Place {
    data_offsets: Option<(u64, u64)>,
}

/// The tensors of safetensors.
///
/// # Errors
/// If the bytes break a rule of the format, or data that the header lists are not there.
pub fn checked(bytes: &[u8]) -> Result<Checked<'_>, SafetensorsFault> {
    check_places(bytes)?;
    let tensors = SafeTensors::deserialize(bytes)?;
    let (header, metadata) = SafeTensors::read_metadata(bytes)?;
    // The length of the header takes the first eight bytes.
    Ok(Checked { tensors, metadata, start: size_of::<u64>() + header })
}

/// Tensors as the bytes of a file: name, type, shape and little-endian values of each, and the metadata.
///
/// # Errors
/// If a tensor has not as many bytes as its shape says.
pub fn to_bytes<'a>(
    tensors: impl IntoIterator<Item = (&'a str, Dtype, &'a [usize], &'a [u8])>,
    metadata: HashMap<String, String>,
) -> Result<Vec<u8>, SafetensorsFault> {
    let views = tensors
        .into_iter()
        .map(|(name, dtype, shape, data)| Ok((name, TensorView::new(dtype, shape.to_vec(), data)?)))
        .collect::<Result<Vec<_>, SafeTensorError>>()?;
    Ok(serialize(views, Some(metadata))?)
}

/// That all data which the header lists are there. The library adds up the ends unchecked.
fn check_places(bytes: &[u8]) -> Result<(), SafetensorsFault> {
    let (length, rest) = bytes.split_first_chunk().ok_or(SafeTensorError::HeaderTooSmall)?;
    let header = usize::try_from(u64::from_le_bytes(*length)).ok().and_then(|length| rest.get(..length));
    let header = header.ok_or(SafeTensorError::InvalidHeaderLength)?;
    let places: BTreeMap<String, Place> = serde_json::from_slice(header).map_err(SafetensorsFault::Header)?;
    let found = (rest.len() - header.len()) as u64;
    for (name, Place { data_offsets }) in places {
        if let Some((_, end)) = data_offsets.filter(|(_, end)| *end > found) {
            return Err(SafetensorsFault::Truncated { name, end, found });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes whose sum overflows a machine word.
    #[test]
    fn data_that_no_file_could_hold_are_refused() {
        let length = (1_u64 << 61) - 1;
        let tensors: Vec<String> = (0..8)
            .map(|i| {
                let (start, end) = (i * length, (i + 1) * length);
                format!(r#""t{i}":{{"dtype":"U8","shape":[{length}],"data_offsets":[{start},{end}]}}"#)
            })
            .collect();
        let header = format!("{{{}}}", tensors.join(","));
        let bytes = [&(header.len() as u64).to_le_bytes(), header.as_bytes()].concat();
        assert!(matches!(checked(&bytes), Err(SafetensorsFault::Truncated { found: 0, .. })));
        let bytes = [&u64::MAX.to_le_bytes(), header.as_bytes()].concat();
        assert!(matches!(checked(&bytes), Err(SafetensorsFault::Unsound(_))));
        assert!(matches!(checked(b""), Err(SafetensorsFault::Unsound(_))));
    }

    #[test]
    fn what_is_written_is_read() {
        let metadata = HashMap::from([("key".to_owned(), "value".to_owned())]);
        let bytes = to_bytes([("a", Dtype::U8, &[1, 3][..], &[7, 8, 9][..])], metadata.clone()).unwrap();
        let file = checked(&bytes).unwrap();
        assert_eq!(file.metadata.metadata(), &Some(metadata));
        assert_eq!(file.tensors.tensor("a").unwrap().data(), [7, 8, 9]);
        assert_eq!(&bytes[file.start..], [7, 8, 9]);
        let short = to_bytes([("a", Dtype::F32, &[1][..], &[7, 8, 9][..])], HashMap::new());
        assert!(matches!(short, Err(SafetensorsFault::Unsound(_))));
    }
}
