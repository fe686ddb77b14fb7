//! Rules of files of `torch.save`.

/// The rules of a file of `torch.save` that can be broken. Positions count bytes of its `data.pkl`, or of the file where that
/// is of PyTorch before 1.6.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum TorchRule {
    /// Another version of PyTorch's format before 1.6 than the last.
    #[error("written in PyTorch's format from before version 1.6, of another version than 1001")]
    LegacyVersion,
    /// In PyTorch's format before 1.6, the list of storages is none, or does not agree with the tensors.
    #[error("the list of storages does not agree with the storages of the tensors")]
    LegacyKeys,
    /// The file is not a whole ZIP archive.
    #[error("not a whole ZIP archive, as torch.save writes it: {reason}")]
    Archive {
        /// The ZIP reader's reason.
        reason: String,
    },
    /// No entry `*/data.pkl`, or several.
    #[error("archive holds {found} entries data.pkl, expected one")]
    PickleEntries {
        /// How many there are.
        found: usize,
    },
    /// An entry that the pickle refers to is absent.
    #[error("archive has no entry {entry}")]
    MissingEntry {
        /// Name of the entry.
        entry: String,
    },
    /// A compressed or encrypted entry; `torch.save` stores.
    #[error("entry {entry} is {found}, expected stored bytes (was the archive packed anew?)")]
    NotStored {
        /// Name of the entry.
        entry: String,
        /// `compressed` or `encrypted`.
        found: &'static str,
    },
    /// An entry reaches beyond the file.
    #[error("entry {entry} ends at byte {end}, but the file has {length}; is it cut off?")]
    EntryRange {
        /// Name of the entry.
        entry: String,
        /// One past its last byte.
        end: u64,
        /// Bytes of the file.
        length: u64,
    },
    /// The bytes of an entry do not agree with their checksum.
    #[error(
        "entry {entry} does not agree with its checksum; is the file damaged, or saved after \
         torch.serialization.set_crc32_options(False)?"
    )]
    Checksum {
        /// Name of the entry.
        entry: String,
    },
    /// Entries share bytes: together they are longer than the file.
    #[error("entries of the archive lie over each other: together they are longer than the file")]
    Overlap,
    /// Numbers that are not little endian.
    #[error("byteorder is {found:?}, expected \"little\"")]
    ByteOrder {
        /// What the archive states.
        found: String,
    },
    /// A pickle beyond the limit.
    #[error("the pickle has {found} bytes, expected at most {}", crate::pickle::MAX_PICKLE)]
    PickleSize {
        /// Its bytes.
        found: u64,
    },
    /// The pickle ends before its STOP, or in the middle of an opcode.
    #[error("the pickle ends at byte {at}, in the middle of its program")]
    Truncated {
        /// Where.
        at: usize,
    },
    /// A protocol beyond 5.
    #[error("pickle protocol {found}, expected 2 to 5")]
    Protocol {
        /// The protocol.
        found: u8,
    },
    /// An opcode that `torch.save` does not write for lists, dicts, numbers, text and tensors.
    #[error("pickle opcode {opcode:#04x} at byte {at} is not one of those that are read")]
    Opcode {
        /// Where.
        at: usize,
        /// The opcode.
        opcode: u8,
    },
    /// An opcode takes more from the stack than lies there.
    #[error("pickle opcode at byte {at} finds too little on the stack")]
    Stack {
        /// Where.
        at: usize,
    },
    /// A memo slot that was never filled.
    #[error("pickle reads memo slot {slot} at byte {at}, which nothing has filled")]
    Memo {
        /// Where.
        at: usize,
        /// The slot.
        slot: u32,
    },
    /// Text that is not UTF-8.
    #[error("text of the pickle at byte {at} is not UTF-8")]
    Utf8 {
        /// Where.
        at: usize,
    },
    /// A whole number beyond 64 bits.
    #[error("whole number of the pickle at byte {at} has {bytes} bytes, expected at most 8")]
    Integer {
        /// Where.
        at: usize,
        /// Its bytes.
        bytes: usize,
    },
    /// A class or function that is not on the list of known ones. Nothing of a pickle is executed.
    #[error(
        "pickle names {name}, which is not on the list of what is read (tensors, OrderedDict); not executed"
    )]
    Global {
        /// `module name`.
        name: String,
    },
    /// A call with other arguments than the function's, or of what is no function.
    #[error("pickle calls {what} at byte {at} with other arguments than torch.save writes")]
    Call {
        /// Where.
        at: usize,
        /// What is called.
        what: &'static str,
    },
    /// A value of another type than its place asks for.
    #[error("pickle has {found} at byte {at}, expected {expected}")]
    Operand {
        /// Where.
        at: usize,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: &'static str,
    },
    /// Storages of a number type that is not read.
    #[error(
        "storage is of type torch.{found}, expected ByteStorage, LongStorage, HalfStorage, BFloat16Storage, FloatStorage or \
         DoubleStorage"
    )]
    StorageType {
        /// The type.
        found: String,
    },
    /// A storage whose entry has another length than its number of elements.
    #[error("storage {entry} is said to have {elements} elements of {size} bytes, but has {found} bytes")]
    StorageSize {
        /// Name of the entry.
        entry: String,
        /// Elements that the pickle states.
        elements: u64,
        /// Bytes of one.
        size: u64,
        /// Bytes of the entry.
        found: u64,
    },
    /// A tensor with more dimensions than are read.
    #[error("tensor at byte {at} has {found} dimensions, expected at most {}", crate::pickle::MAX_DIMENSIONS)]
    Dimensions {
        /// Where.
        at: usize,
        /// Its dimensions.
        found: usize,
    },
    /// A tensor with a negative or overflowing size, or one that reaches beyond its storage.
    #[error("tensor at byte {at} reaches beyond its storage of {elements} elements")]
    TensorRange {
        /// Where.
        at: usize,
        /// Elements of the storage.
        elements: u64,
    },
}
