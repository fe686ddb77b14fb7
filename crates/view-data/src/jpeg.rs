//! Whether a JPEG file is whole. Decoders do not tell: where data are missing or garbled they go on with grey or with nonsense. JPEG has
//! no checksum, but its codes have to give as many blocks as the picture has, no more and no fewer, and garbled ones hardly ever do.

/// What is wrong with the data of a JPEG file.
#[derive(Debug, thiserror::Error, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum JpegRule {
    /// The file is cut short.
    #[error("it has no end-of-image marker")]
    NoEnd,
    /// Bits that stand for nothing.
    #[error("a code in block {block} of {blocks} means nothing")]
    Code {
        /// The block, from 0, in the order of the file.
        block: usize,
        /// Blocks of the scan.
        blocks: usize,
    },
    /// Fewer blocks than the picture has.
    #[error("its data end in block {block} of {blocks}")]
    Cut {
        /// The block, from 0.
        block: usize,
        /// Blocks of the scan.
        blocks: usize,
    },
    /// More data than the blocks of the picture take.
    #[error("{bytes} bytes of data are left over after its last block")]
    Left {
        /// How many.
        bytes: usize,
    },
}

const START_OF_SCAN: u8 = 0xda;
const END_OF_IMAGE: u8 = 0xd9;
const HUFFMAN_TABLES: u8 = 0xc4;
const RESTART_INTERVAL: u8 = 0xdd;
/// Frames of sequential coding, of 8 bits and extended.
const SEQUENTIAL: [u8; 2] = [0xc0, 0xc1];
/// Frames of another coding, whose blocks are not counted: progressive, lossless, differential, arithmetic.
const OTHER_FRAMES: [u8; 11] = [0xc2, 0xc3, 0xc5, 0xc6, 0xc7, 0xc9, 0xca, 0xcb, 0xcd, 0xce, 0xcf];

/// Some encoders fill up their last words: so many bytes after the last block are no damage.
const FILLED_UP: usize = 8;

/// Checks a file that begins with the start-of-image marker. What it does not understand it leaves to the decoder.
pub(crate) fn check(bytes: &[u8]) -> Result<(), JpegRule> {
    let mut tables = Tables::default();
    let (mut frame, mut interval) = (None, 0);
    let mut offset = 2;
    // Segments are passed over by their length: a thumbnail in one has an end marker of its own.
    while let Some(&[0xff, marker]) = bytes.get(offset..offset + 2) {
        match marker {
            // A marker may be preceded by any number of fill bytes.
            0xff => {
                offset += 1;
                continue;
            }
            END_OF_IMAGE => return Ok(()),
            _ => {}
        }
        let Some(&[high, low]) = bytes.get(offset + 2..offset + 4) else { return Err(JpegRule::NoEnd) };
        let length = usize::from(u16::from_be_bytes([high, low]));
        let Some(body) = bytes.get(offset + 4..offset + 2 + length.max(2)) else {
            return Err(JpegRule::NoEnd);
        };
        offset += 2 + length;
        match marker {
            HUFFMAN_TABLES => tables.read(body),
            RESTART_INTERVAL => {
                interval = body.first_chunk().map_or(0, |&n| usize::from(u16::from_be_bytes(n)));
            }
            _ if SEQUENTIAL.contains(&marker) => frame = Frame::read(body),
            _ if OTHER_FRAMES.contains(&marker) => frame = None,
            START_OF_SCAN => {
                let scan = frame.as_ref().and_then(|frame: &Frame| Scan::read(body, frame, &tables));
                match scan {
                    Some(scan) => offset = scan.check(bytes, offset, interval)?,
                    // In a scan the marker's bytes cannot occur as data.
                    None => {
                        let rest = bytes.get(offset..).unwrap_or_default();
                        let ends = rest.windows(2).any(|pair| pair == [0xff, END_OF_IMAGE]);
                        return if ends { Ok(()) } else { Err(JpegRule::NoEnd) };
                    }
                }
            }
            _ => {}
        }
    }
    Err(JpegRule::NoEnd)
}

/// For the next 16 bits the length of the code that they begin with, and what it stands for; a length of 0 where there is none.
type Table = Vec<(u8, u8)>;

/// Tables by number: for first coefficients, and for the others.
#[derive(Default)]
struct Tables([[Option<Table>; 4]; 2]);

impl Tables {
    fn read(&mut self, mut body: &[u8]) {
        while let Some((&head, rest)) = body.split_first() {
            let Some((counts, rest)) = rest.split_at_checked(16) else { return };
            let total = counts.iter().map(|&count| usize::from(count)).sum();
            let Some((symbols, rest)) = rest.split_at_checked(total) else { return };
            body = rest;
            let mut table = vec![(0, 0); 1 << 16];
            let (mut code, mut symbols) = (0usize, symbols.iter());
            for (length, &count) in (1..=16).zip(counts) {
                for &symbol in symbols.by_ref().take(usize::from(count)) {
                    let first = code << (16 - length);
                    let Some(places) = table.get_mut(first..first + (1 << (16 - length))) else { return };
                    places.fill((length as u8, symbol));
                    code += 1;
                }
                code <<= 1;
            }
            if let Some(place) = self
                .0
                .get_mut(usize::from(head >> 4))
                .and_then(|tables| tables.get_mut(usize::from(head & 15)))
            {
                *place = Some(table);
            }
        }
    }
}

/// Size and components of a sequential picture.
struct Frame {
    width: usize,
    height: usize,
    /// Number, and samples per block row and column of the picture, of each component.
    components: Vec<(u8, usize, usize)>,
}

impl Frame {
    fn read(body: &[u8]) -> Option<Self> {
        let &[_, h1, h0, w1, w0, count, ref rest @ ..] = body else { return None };
        let [height, width] = [[h1, h0], [w1, w0]].map(|side| usize::from(u16::from_be_bytes(side)));
        let components: Vec<_> = rest
            .as_chunks::<3>()
            .0
            .iter()
            .map(|&[number, sampling, _]| (number, usize::from(sampling >> 4), usize::from(sampling & 15)))
            .collect();
        // A height of 0 is stated later, which hardly any encoder does.
        let is_whole = components.len() == usize::from(count)
            && components.iter().all(|(_, h, v)| (1..=4).contains(h) && (1..=4).contains(v))
            && width > 0
            && height > 0;
        is_whole.then_some(Self { width, height, components })
    }
}

/// What a scan holds: the two tables of each block of a unit, and how many units there are.
struct Scan<'a> {
    blocks: Vec<(&'a Table, &'a Table)>,
    units: usize,
}

impl<'a> Scan<'a> {
    fn read(body: &[u8], frame: &Frame, tables: &'a Tables) -> Option<Self> {
        let (&count, rest) = body.split_first()?;
        let mut chosen = Vec::new();
        for &[number, numbers] in rest.as_chunks::<2>().0.iter().take(usize::from(count)) {
            let &(_, h, v) = frame.components.iter().find(|(known, _, _)| *known == number)?;
            let first = tables.0[0].get(usize::from(numbers >> 4))?.as_ref()?;
            let others = tables.0[1].get(usize::from(numbers & 15))?.as_ref()?;
            chosen.push((h, v, (first, others)));
        }
        let largest = |side: fn(&(u8, usize, usize)) -> usize| frame.components.iter().map(side).max();
        let (across, down) = (largest(|&(_, h, _)| h)?, largest(|&(_, _, v)| v)?);
        if let [(h, v, tables)] = chosen[..] {
            // Alone, a component has the blocks that its own samples fill.
            let blocks =
                |side: usize, samples: usize, most: usize| (side * samples).div_ceil(most).div_ceil(8);
            let units = blocks(frame.width, h, across) * blocks(frame.height, v, down);
            return Some(Self { blocks: vec![tables], units });
        }
        let units = frame.width.div_ceil(8 * across) * frame.height.div_ceil(8 * down);
        let blocks = chosen.iter().flat_map(|&(h, v, tables)| std::iter::repeat_n(tables, h * v)).collect();
        Some(Self { blocks, units })
    }

    /// Counts the blocks of the data that begin at a byte; where the marker after them begins.
    fn check(&self, bytes: &[u8], mut offset: usize, interval: usize) -> Result<usize, JpegRule> {
        let interval = if interval == 0 { self.units } else { interval };
        let blocks = self.units * self.blocks.len();
        let (mut done, mut data) = (0, Vec::new());
        while done < self.units {
            let end = unstuff(bytes, offset, &mut data).ok_or(JpegRule::NoEnd)?;
            let mut bits = Bits { data: &data, at: 0, held: 0, buffer: 0, taken: 0 };
            for unit in done..self.units.min(done + interval) {
                for (i, tables) in self.blocks.iter().enumerate() {
                    let block = unit * self.blocks.len() + i;
                    let is_code = bits.pass_block(tables);
                    if bits.taken > 8 * data.len() {
                        return Err(JpegRule::Cut { block, blocks });
                    }
                    if !is_code {
                        return Err(JpegRule::Code { block, blocks });
                    }
                }
            }
            done += interval;
            let left = data.len() - bits.taken.div_ceil(8);
            if left > FILLED_UP {
                return Err(JpegRule::Left { bytes: left });
            }
            offset = end;
            if done < self.units {
                // Between two intervals stands a restart marker.
                match bytes.get(offset + 1) {
                    Some(0xd0..=0xd7) => offset += 2,
                    Some(_) => return Err(JpegRule::Cut { block: done * self.blocks.len(), blocks }),
                    None => return Err(JpegRule::NoEnd),
                }
            }
        }
        Ok(offset)
    }
}

/// Takes data up to the next marker, without the zeros that follow data bytes of 0xff; where the marker begins.
fn unstuff(bytes: &[u8], mut offset: usize, data: &mut Vec<u8>) -> Option<usize> {
    data.clear();
    loop {
        let rest = bytes.get(offset..)?;
        let stop = rest.iter().position(|&byte| byte == 0xff)?;
        data.extend_from_slice(&rest[..stop]);
        offset += stop;
        match bytes.get(offset + 1)? {
            0 => {
                data.push(0xff);
                offset += 2;
            }
            0xff => offset += 1,
            _ => return Some(offset),
        }
    }
}

/// Bits of data, the highest of a byte first; zeros after the end.
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// How many bits of the buffer, from its highest, are filled.
    held: u32,
    buffer: u64,
    /// Bits that were passed.
    taken: usize,
}

impl Bits<'_> {
    /// What the next code of a table stands for.
    fn code(&mut self, table: &Table) -> Option<u8> {
        while self.held <= 56 {
            let byte = self.data.get(self.at).copied().unwrap_or(0);
            self.buffer |= u64::from(byte) << (56 - self.held);
            self.held += 8;
            self.at += 1;
        }
        let (length, symbol) = table[(self.buffer >> 48) as usize];
        self.pass(u32::from(length));
        (length > 0).then_some(symbol)
    }

    /// Passes over at most 16 bits. With the code before them they are fewer than the buffer holds.
    fn pass(&mut self, count: u32) {
        self.buffer <<= count;
        self.held -= count;
        self.taken += count as usize;
    }

    /// Passes over the coefficients of a block; whether there were some.
    fn pass_block(&mut self, (first, others): &(&Table, &Table)) -> bool {
        match self.code(first) {
            Some(size @ 0..=15) => self.pass(u32::from(size)),
            _ => return false,
        }
        let mut place = 1;
        while place < 64 {
            let Some(symbol) = self.code(others) else { return false };
            let (zeros, size) = (symbol >> 4, symbol & 15);
            match (zeros, size) {
                (15, 0) => place += 16,
                (_, 0) => break,
                _ => {
                    place += usize::from(zeros) + 1;
                    self.pass(u32::from(size));
                }
            }
            if place > 64 {
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, RgbImage};

    /// A picture with detail, as large as asked for.
    fn jpeg(width: u32, height: u32, quality: u8) -> Vec<u8> {
        let picture = RgbImage::from_fn(width, height, |x, y| {
            let hash = (x * 7919 + y * 104_729) ^ (x * y);
            image::Rgb([(hash % 251) as u8, (x * 3 % 256) as u8, (y * 5 % 256) as u8])
        });
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
        encoder.encode(&picture, width, height, ExtendedColorType::Rgb8).unwrap();
        bytes
    }

    /// Where the data of the only scan begin.
    fn data_of(bytes: &[u8]) -> usize {
        let marker = bytes.windows(2).position(|pair| pair == [0xff, START_OF_SCAN]).unwrap();
        marker + 2 + usize::from(u16::from_be_bytes([bytes[marker + 2], bytes[marker + 3]]))
    }

    #[test]
    fn whole_files_pass() {
        for (width, height) in [(1, 1), (8, 8), (17, 9), (64, 48), (131, 77)] {
            for quality in [5, 50, 95, 100] {
                assert_eq!(check(&jpeg(width, height, quality)), Ok(()), "{width}x{height}, {quality}");
            }
        }
        // A file may go on after its end.
        let longer = [&jpeg(17, 9, 80)[..], b"what a telephone adds"].concat();
        assert_eq!(check(&longer), Ok(()));
    }

    #[test]
    fn cut_files_are_told_with_an_end_marker_too() {
        let whole = jpeg(48, 32, 80);
        let start = data_of(&whole);
        for cut in start..whole.len() - 2 {
            assert!(check(&whole[..cut]).is_err(), "{cut} of {}", whole.len());
            // What is cut off within the last bytes may be filling.
            if cut + 4 < whole.len() {
                let ended = [&whole[..cut], &[0xff, END_OF_IMAGE]].concat();
                assert!(check(&ended).is_err(), "{cut} of {}", whole.len());
            }
        }
        assert_eq!(check(&whole[..whole.len() - 2]), Err(JpegRule::NoEnd));
    }

    #[test]
    fn garbled_data_are_told() {
        let whole = jpeg(160, 120, 80);
        let start = data_of(&whole);
        let middle = start + (whole.len() - start) / 3..start + 2 * (whole.len() - start) / 3;
        let mut zeroed = whole.clone();
        zeroed[middle].fill(0);
        assert!(check(&zeroed).is_err());
        // A block of a disk that comes from elsewhere.
        let mut foreign = whole.clone();
        for (i, byte) in foreign[start + 100..start + 612].iter_mut().enumerate() {
            *byte = (i * i * 31 % 255) as u8;
        }
        assert!(check(&foreign).is_err());
        // Single bits: codes fall into step again after some blocks, but often not with the same number of them.
        let flips = (start..whole.len() - 40).step_by(17);
        let told = flips.clone().filter(|&index| {
            let mut flipped = whole.clone();
            flipped[index] ^= 0x10;
            check(&flipped).is_err()
        });
        let (told, all) = (told.count(), flips.count());
        assert!(told * 8 > all, "{told} of {all} flipped bits");
    }
}
