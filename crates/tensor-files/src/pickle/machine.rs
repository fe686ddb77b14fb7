//! The stack machine of Python's pickle, protocols 2 to 5, as far as `torch.save` uses it. It builds plain values and
//! executes nothing: a call is accepted for a few functions whose results are known beforehand.
//!
//! Every opcode adds at most one value, and no length of the file is trusted before that many bytes have been seen,
//! so memory is bounded by the pickle's length. Nothing recurses.

use super::value::{Pickle, Span, Value};
use crate::TorchRule as Rule;
use std::collections::HashMap;

pub(super) type Result<T> = std::result::Result<T, Rule>;

/// Runs the pickle that starts at byte `start` to its STOP; what it builds, and where it ends.
pub(crate) fn run(bytes: Vec<u8>, start: usize) -> Result<(Pickle, usize)> {
    let pools = Pickle {
        bytes,
        tuples: Vec::new(),
        lists: Vec::new(),
        dicts: Vec::new(),
        storages: Vec::new(),
        tensors: Vec::new(),
        root: Value::None,
    };
    let mut machine =
        Machine { pools, at: start, stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
    while machine.step()? {}
    Ok((machine.pools, machine.at))
}

pub(super) struct Machine {
    pub(super) pools: Pickle,
    /// Position in the bytes: the opcode's own while its arguments are not read yet.
    at: usize,
    pub(super) stack: Vec<Value>,
    /// Heights of the stack at which a MARK lies.
    marks: Vec<usize>,
    memo: HashMap<u32, Value>,
}

impl Machine {
    /// One opcode; false after STOP.
    fn step(&mut self) -> Result<bool> {
        let position = self.at;
        let [opcode] = self.array()?;
        match opcode {
            b'.' => {
                self.pools.root = self.pop(position)?;
                return Ok(false);
            }
            0x80 => {
                let [found] = self.array()?;
                if !(2..=5).contains(&found) {
                    return Err(Rule::Protocol { found });
                }
            }
            // FRAME states how much to read ahead; all of it is here.
            0x95 => drop(self.array::<8>()?),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop(position)?),
            b'1' => {
                let height = self.mark(position)?;
                self.stack.truncate(height);
            }
            b'2' => {
                let top = self.top(position)?;
                self.stack.push(top);
            }
            b'N' => self.stack.push(Value::None),
            0x88 => self.stack.push(Value::Bool(true)),
            0x89 => self.stack.push(Value::Bool(false)),
            b'J' => {
                let number = i32::from_le_bytes(self.array()?);
                self.stack.push(Value::Int(number.into()));
            }
            b'K' => {
                let [number] = self.array()?;
                self.stack.push(Value::Int(number.into()));
            }
            b'M' => {
                let number = u16::from_le_bytes(self.array()?);
                self.stack.push(Value::Int(number.into()));
            }
            0x8a => {
                let [length] = self.array()?;
                let number = self.long(position, length.into())?;
                self.stack.push(number);
            }
            b'G' => {
                let number = f64::from_be_bytes(self.array()?);
                self.stack.push(Value::Float(number));
            }
            // Text of Python 2, with a length of one byte or four.
            b'U' => {
                let [length] = self.array()?;
                self.text(position, length.into())?;
            }
            b'T' | b'X' => {
                let length = u32::from_le_bytes(self.array()?);
                self.text(position, length.into())?;
            }
            0x8c => {
                let [length] = self.array()?;
                self.text(position, length.into())?;
            }
            0x8d => {
                let length = u64::from_le_bytes(self.array()?);
                self.text(position, length)?;
            }
            b']' | b'}' | b')' => self.empty(opcode),
            b'l' | b'd' | b't' => self.marked(position, opcode)?,
            0x85..=0x87 => {
                let height = self.below(position, usize::from(opcode - 0x84))?;
                self.tuple(height);
            }
            b'a' => {
                let height = self.below(position, 1)?;
                self.append(position, height)?;
            }
            b'e' => {
                let height = self.mark(position)?;
                self.append(position, height)?;
            }
            b's' => {
                let height = self.below(position, 2)?;
                self.set(position, height)?;
            }
            b'u' => {
                let height = self.mark(position)?;
                self.set(position, height)?;
            }
            b'q' => {
                let [slot] = self.array()?;
                self.put(position, slot.into())?;
            }
            b'r' => {
                let slot = u32::from_le_bytes(self.array()?);
                self.put(position, slot)?;
            }
            // MEMOIZE fills the slot after the last one; no memo has more slots than the file has bytes.
            0x94 => self.put(position, self.memo.len() as u32)?,
            b'h' => {
                let [slot] = self.array()?;
                self.recall(position, slot.into())?;
            }
            b'j' => {
                let slot = u32::from_le_bytes(self.array()?);
                self.recall(position, slot)?;
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.global(module, name)?;
            }
            0x93 => {
                let height = self.below(position, 2)?;
                let (module, name) = (self.as_text(position, height)?, self.as_text(position, height + 1)?);
                self.stack.truncate(height);
                self.global(module, name)?;
            }
            b'R' => self.call(position)?,
            b'b' => self.attributes(position)?,
            b'Q' => self.persistent(position)?,
            _ => return Err(Rule::Opcode { at: position, opcode }),
        }
        Ok(true)
    }

    /// The next bytes as a range, if there are so many.
    fn span(&mut self, length: u64) -> Result<Span> {
        let start = self.at;
        let end = usize::try_from(length).ok().and_then(|length| start.checked_add(length));
        let Some(end) = end.filter(|&end| end <= self.pools.bytes.len()) else {
            return Err(Rule::Truncated { at: self.pools.bytes.len() });
        };
        self.at = end;
        // No more than `MAX_PICKLE` bytes are read.
        Ok(Span { start: start as u32, length: (end - start) as u32 })
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let span = self.span(N as u64)?;
        let mut array = [0; N];
        array.copy_from_slice(&self.pools.bytes[span.range()]);
        Ok(array)
    }

    /// Text up to the end of its line, without the line feed.
    fn line(&mut self) -> Result<Span> {
        let rest = &self.pools.bytes[self.at..];
        let length = rest.iter().position(|&byte| byte == b'\n');
        let length = length.ok_or(Rule::Truncated { at: self.pools.bytes.len() })?;
        let span = self.span(length as u64)?;
        self.at += 1;
        Ok(span)
    }

    fn text(&mut self, position: usize, length: u64) -> Result<()> {
        let span = self.span(length)?;
        if std::str::from_utf8(&self.pools.bytes[span.range()]).is_err() {
            return Err(Rule::Utf8 { at: position });
        }
        self.stack.push(Value::Text(span));
        Ok(())
    }

    /// A whole number of little-endian two's complement bytes.
    fn long(&mut self, position: usize, length: u64) -> Result<Value> {
        let span = self.span(length)?;
        let bytes = &self.pools.bytes[span.range()];
        if bytes.len() > 8 {
            return Err(Rule::Integer { at: position, bytes: bytes.len() });
        }
        let negative = bytes.last().is_some_and(|&byte| byte >= 0x80);
        let mut wide = [if negative { 0xff } else { 0 }; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        Ok(Value::Int(i64::from_le_bytes(wide)))
    }

    /// The lowest height that may be popped to: what lies below the last MARK is out of reach.
    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    pub(super) fn top(&self, position: usize) -> Result<Value> {
        self.stack[self.floor()..].last().copied().ok_or(Rule::Stack { at: position })
    }

    pub(super) fn pop(&mut self, position: usize) -> Result<Value> {
        let top = self.top(position)?;
        self.stack.pop();
        Ok(top)
    }

    /// Height of the stack below its top `count` values.
    fn below(&self, position: usize, count: usize) -> Result<usize> {
        let height = self.stack.len().checked_sub(count).filter(|&height| height >= self.floor());
        height.ok_or(Rule::Stack { at: position })
    }

    /// Takes the last MARK off; its height.
    fn mark(&mut self, position: usize) -> Result<usize> {
        self.marks.pop().ok_or(Rule::Stack { at: position })
    }

    fn empty(&mut self, opcode: u8) {
        let value = match opcode {
            b']' => self.new_list(Vec::new()),
            b'}' => self.new_dict(),
            _ => Value::Tuple(Span { start: 0, length: 0 }),
        };
        self.stack.push(value);
    }

    fn new_list(&mut self, items: Vec<Value>) -> Value {
        self.pools.lists.push(items);
        Value::List(self.pools.lists.len() as u32 - 1)
    }

    pub(super) fn new_dict(&mut self) -> Value {
        self.pools.dicts.push(Vec::new());
        Value::Dict(self.pools.dicts.len() as u32 - 1)
    }

    /// LIST, DICT and TUPLE, from what lies above the last MARK.
    fn marked(&mut self, position: usize, opcode: u8) -> Result<()> {
        let height = self.mark(position)?;
        match opcode {
            b'l' => {
                let items = self.stack.split_off(height);
                let list = self.new_list(items);
                self.stack.push(list);
            }
            b'd' => {
                let dict = self.new_dict();
                self.stack.insert(height, dict);
                self.set(position, height + 1)?;
            }
            _ => self.tuple(height),
        }
        Ok(())
    }

    fn tuple(&mut self, height: usize) {
        let start = self.pools.tuples.len() as u32;
        self.pools.tuples.extend(self.stack.drain(height..));
        let length = self.pools.tuples.len() as u32 - start;
        self.stack.push(Value::Tuple(Span { start, length }));
    }

    /// Appends what lies above `height` to the list below it.
    fn append(&mut self, position: usize, height: usize) -> Result<()> {
        let list = match height.checked_sub(1).filter(|&below| below >= self.floor()) {
            Some(below) => self.stack[below],
            None => return Err(Rule::Stack { at: position }),
        };
        let Value::List(list) = list else {
            return Err(Rule::Operand { at: position, expected: "list", found: list.type_name() });
        };
        self.pools.lists[list as usize].extend(self.stack.drain(height..));
        Ok(())
    }

    /// Sets the pairs that lie above `height` in the dict below it.
    fn set(&mut self, position: usize, height: usize) -> Result<()> {
        let dict = match height.checked_sub(1).filter(|&below| below >= self.floor()) {
            Some(below) if (self.stack.len() - height).is_multiple_of(2) => self.stack[below],
            _ => return Err(Rule::Stack { at: position }),
        };
        let Value::Dict(dict) = dict else {
            return Err(Rule::Operand { at: position, expected: "dict", found: dict.type_name() });
        };
        let pairs = self.stack[height..].chunks_exact(2).map(|pair| (pair[0], pair[1]));
        self.pools.dicts[dict as usize].extend(pairs);
        self.stack.truncate(height);
        Ok(())
    }

    fn put(&mut self, position: usize, slot: u32) -> Result<()> {
        let top = self.top(position)?;
        self.memo.insert(slot, top);
        Ok(())
    }

    fn recall(&mut self, position: usize, slot: u32) -> Result<()> {
        let value = self.memo.get(&slot).copied().ok_or(Rule::Memo { at: position, slot })?;
        self.stack.push(value);
        Ok(())
    }

    fn as_text(&self, position: usize, height: usize) -> Result<Span> {
        match self.stack[height] {
            Value::Text(span) => Ok(span),
            other => Err(Rule::Operand { at: position, expected: "str", found: other.type_name() }),
        }
    }
}
