//! The values of a pickle. Containers are in pools and refer to each other by position. So a list that contains itself does not leak, a value with many
//! references is stored once, and memory is bounded by the length of the pickle.

/// Longest text that is looked at, bytes: one long text may stand for many values, and reading it for each would take
/// time without bound.
pub(crate) const MAX_TEXT: usize = 4096;

/// A value; containers by their position in the pools of [`Pickle`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// `None`.
    None,
    /// `True` or `False`.
    Bool(bool),
    /// A whole number of at most 64 bits.
    Int(i64),
    /// A float.
    Float(f64),
    /// A str: [`Pickle::text`].
    Text(Span),
    /// A class or function of those that are read.
    Global(Global),
    /// A tuple: [`Pickle::items`].
    Tuple(Span),
    /// A list: [`Pickle::items`].
    List(u32),
    /// A dict: [`Pickle::get`].
    Dict(u32),
    /// A storage.
    Storage(u32),
    /// A tensor: [`Pickle::tensor`].
    Tensor(u32),
}

/// A range of the pickle's bytes or of its pool of tuple entries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
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
pub enum Global {
    /// `torch._utils._rebuild_tensor_v2` and its forerunner.
    RebuildTensor,
    /// `torch._utils._rebuild_parameter`.
    RebuildParameter,
    /// `collections.OrderedDict`.
    OrderedDict,
    /// A class such as `torch.FloatStorage`.
    Storage(Dtype),
}

/// Number types of the storages that are read; little endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dtype {
    /// `torch.uint8`.
    U8,
    /// `torch.int64`.
    I64,
    /// `torch.float16`.
    F16,
    /// `torch.bfloat16`.
    BF16,
    /// `torch.float32`.
    F32,
    /// `torch.float64`.
    F64,
}

impl Dtype {
    /// Bytes of one element.
    pub fn size(self) -> u64 {
        match self {
            Self::U8 => 1,
            Self::F16 | Self::BF16 => 2,
            Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
        }
    }
}

/// The elements behind one or more tensors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Storage {
    pub(crate) dtype: Dtype,
    pub(crate) key: Span,
    pub(crate) elements: u64,
}

/// A view of a storage. It does not reach beyond the elements that the storage is said to have.
#[derive(Debug, Clone, Copy)]
pub struct Tensor {
    pub(crate) storage: Storage,
    pub(crate) offset: u64,
    /// Sizes and strides, elements; the first `dimensions` of them.
    pub(crate) sizes: [u64; super::MAX_DIMENSIONS],
    pub(crate) strides: [u64; super::MAX_DIMENSIONS],
    pub(crate) dimensions: usize,
}

impl Tensor {
    /// Length of each dimension.
    pub fn shape(&self) -> &[u64] {
        &self.sizes[..self.dimensions]
    }

    /// Number of elements; a tensor may repeat those of its storage, so it says nothing about memory.
    pub fn count(&self) -> u64 {
        if self.shape().contains(&0) {
            return 0;
        }
        self.shape().iter().fold(1, |count, &size| count.saturating_mul(size))
    }

    /// The type of its elements.
    pub fn dtype(&self) -> Dtype {
        self.storage.dtype
    }

    /// Whether its elements lie one after the other, in row-major order.
    pub fn is_contiguous(&self) -> bool {
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

/// What a pickle has built. Values of another file mean something else here, or nothing.
#[derive(Debug)]
pub struct Pickle {
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
    pub fn root(&self) -> Value {
        self.root
    }

    /// The bytes that it was read from.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Key of every storage, and the bytes of one of its elements.
    pub(crate) fn storages(&self) -> impl Iterator<Item = (&str, u64)> {
        self.storages.iter().filter_map(|s| Some((self.text(Value::Text(s.key))?, s.dtype.size())))
    }

    /// The entries of a dict.
    pub(crate) fn entries(&self, value: Value) -> Option<&[(Value, Value)]> {
        match value {
            Value::Dict(dict) => self.dicts.get(dict as usize).map(Vec::as_slice),
            _ => None,
        }
    }

    /// The entries of a list or tuple.
    pub fn items(&self, value: Value) -> Option<&[Value]> {
        match value {
            Value::List(list) => self.lists.get(list as usize).map(Vec::as_slice),
            Value::Tuple(span) => self.tuples.get(span.range()),
            _ => None,
        }
    }

    /// A text of at most `MAX_TEXT` bytes.
    pub fn text(&self, value: Value) -> Option<&str> {
        match value {
            Value::Text(span) if span.length as usize <= MAX_TEXT => {
                std::str::from_utf8(self.bytes.get(span.range())?).ok()
            }
            _ => None,
        }
    }

    /// The tensor, if it is one.
    pub fn tensor(&self, value: Value) -> Option<&Tensor> {
        match value {
            Value::Tensor(tensor) => self.tensors.get(tensor as usize),
            _ => None,
        }
    }

    /// Whether the value is a dict.
    pub fn is_dict(&self, value: Value) -> bool {
        matches!(value, Value::Dict(_))
    }

    /// The value of a key of a dict; the last one, as in Python, if it was set twice.
    pub fn get(&self, dict: Value, key: &str) -> Option<Value> {
        let is_key = |name: Value| match name {
            Value::Text(span) => self.bytes.get(span.range()) == Some(key.as_bytes()),
            _ => false,
        };
        let entries = self.entries(dict)?.iter().rev();
        entries.copied().find(|&(name, _)| is_key(name)).map(|(_, value)| value)
    }
}

impl Value {
    /// What tells a dict from another one of equal content.
    pub fn dict(self) -> Option<u32> {
        if let Self::Dict(dict) = self { Some(dict) } else { None }
    }

    /// Its type, as Python calls it.
    pub fn type_name(self) -> &'static str {
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
