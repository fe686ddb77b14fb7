//! What a pickle builds. Containers lie in pools and refer to each other by position: a list that holds itself is no
//! leak, and what is referred to often is stored once, so that memory follows the pickle's length.

/// Longest text that is looked at, bytes: one long text may stand for many values, and reading it for each would take
/// time without bound.
pub(crate) const MAX_TEXT: usize = 4096;

/// A value; containers by their position in the pools of [`Pickle`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(Span),
    Global(Global),
    Tuple(Span),
    List(u32),
    Dict(u32),
    Storage(u32),
    Tensor(u32),
}

/// A range of the pickle's bytes or of its pool of tuple entries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Span {
    pub(super) start: u32,
    pub(super) length: u32,
}

impl Span {
    pub(super) fn range(self) -> std::ops::Range<usize> {
        self.start as usize..self.start as usize + self.length as usize
    }
}

/// Classes and functions that a pickle may name. None of them is ever called: the reader knows what they build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Global {
    RebuildTensor,
    OrderedDict,
    Storage(Dtype),
}

/// Number types of the storages that are read; little endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Dtype {
    U8,
    I64,
    F32,
    F64,
}

impl Dtype {
    /// Bytes of one element.
    pub(crate) fn size(self) -> u64 {
        match self {
            Self::U8 => 1,
            Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
        }
    }
}

/// The elements behind one or more tensors: the entry `data/<key>` of the archive.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Storage {
    pub(super) dtype: Dtype,
    pub(super) key: Span,
    pub(super) elements: u64,
}

/// A view of a storage. It does not reach beyond the elements that the storage is said to have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tensor {
    pub(super) storage: Storage,
    pub(super) offset: u64,
    /// Sizes and strides, elements; the first `dimensions` of them.
    pub(super) sizes: [u64; super::MAX_DIMENSIONS],
    pub(super) strides: [u64; super::MAX_DIMENSIONS],
    pub(super) dimensions: usize,
}

impl Tensor {
    /// Length of each dimension.
    pub(crate) fn shape(&self) -> &[u64] {
        &self.sizes[..self.dimensions]
    }

    /// Number of elements; a tensor may repeat those of its storage, so it says nothing about memory.
    pub(crate) fn count(&self) -> u64 {
        if self.shape().contains(&0) {
            return 0;
        }
        self.shape().iter().fold(1, |count, &size| count.saturating_mul(size))
    }

    pub(crate) fn dtype(&self) -> Dtype {
        self.storage.dtype
    }

    /// Whether its elements lie one after the other, in row-major order.
    pub(crate) fn is_contiguous(&self) -> bool {
        let mut expected = 1;
        for (&size, &stride) in self.shape().iter().zip(&self.strides).rev() {
            if size != 1 && stride != expected {
                return false;
            }
            expected = size.saturating_mul(expected);
        }
        true
    }
}

/// What a pickle has built.
#[derive(Debug)]
pub(crate) struct Pickle {
    pub(super) bytes: Vec<u8>,
    pub(super) tuples: Vec<Value>,
    pub(super) lists: Vec<Vec<Value>>,
    pub(super) dicts: Vec<Vec<(Value, Value)>>,
    pub(super) storages: Vec<Storage>,
    pub(super) tensors: Vec<Tensor>,
    pub(super) root: Value,
}

impl Pickle {
    /// The value that was saved.
    pub(crate) fn root(&self) -> Value {
        self.root
    }

    /// The entries of a list or tuple.
    pub(crate) fn items(&self, value: Value) -> Option<&[Value]> {
        match value {
            Value::List(list) => Some(&self.lists[list as usize]),
            Value::Tuple(span) => Some(&self.tuples[span.range()]),
            _ => None,
        }
    }

    /// A text of at most [`MAX_TEXT`] bytes.
    pub(crate) fn text(&self, value: Value) -> Option<&str> {
        match value {
            Value::Text(span) if span.length as usize <= MAX_TEXT => {
                std::str::from_utf8(&self.bytes[span.range()]).ok()
            }
            _ => None,
        }
    }

    pub(crate) fn tensor(&self, value: Value) -> Option<&Tensor> {
        match value {
            Value::Tensor(tensor) => Some(&self.tensors[tensor as usize]),
            _ => None,
        }
    }

    pub(crate) fn is_dict(&self, value: Value) -> bool {
        matches!(value, Value::Dict(_))
    }

    /// The value of a key of a dict; the last one, as in Python, if it was set twice.
    pub(crate) fn get(&self, dict: Value, key: &str) -> Option<Value> {
        let Value::Dict(dict) = dict else { return None };
        let is_key = |name: Value| match name {
            Value::Text(span) => &self.bytes[span.range()] == key.as_bytes(),
            _ => false,
        };
        let entries = self.dicts[dict as usize].iter().rev();
        entries.copied().find(|&(name, _)| is_key(name)).map(|(_, value)| value)
    }
}

impl Value {
    /// What tells a dict from another one of equal content.
    pub(crate) fn dict(self) -> Option<u32> {
        if let Self::Dict(dict) = self { Some(dict) } else { None }
    }

    /// Its type, as Python calls it.
    pub(crate) fn type_name(self) -> &'static str {
        match self {
            Self::None => "None",
            Self::Bool(_) => "bool",
            Self::Int(_) => "int",
            Self::Float(_) => "float",
            Self::Text(_) => "str",
            Self::Global(_) => "a class or function",
            Self::Tuple(_) => "tuple",
            Self::List(_) => "list",
            Self::Dict(_) => "dict",
            Self::Storage(_) => "a storage",
            Self::Tensor(_) => "a tensor",
        }
    }
}
