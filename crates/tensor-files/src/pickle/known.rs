//! The names that a pickle of `torch.save` may use. Names are looked up only here.

use super::machine::{Machine, Result};
use super::value::{Dtype, Global, Span, Storage, Tensor, Value};
use crate::TorchRule as Rule;

impl Machine {
    /// GLOBAL and STACK_GLOBAL: a class or function by module and name.
    pub(super) fn global(&mut self, module: Span, name: Span) -> Result<()> {
        let text = |span: Span| String::from_utf8_lossy(&self.pools.bytes[span.range()]);
        let (module, name) = (text(module), text(name));
        let global = match (module.as_ref(), name.as_ref()) {
            ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2") => Global::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Global::RebuildParameter,
            ("collections", "OrderedDict") => Global::OrderedDict,
            ("torch", "ByteStorage") => Global::Storage(Dtype::U8),
            ("torch", "LongStorage") => Global::Storage(Dtype::I64),
            ("torch", "HalfStorage") => Global::Storage(Dtype::F16),
            ("torch", "BFloat16Storage") => Global::Storage(Dtype::BF16),
            ("torch", "FloatStorage") => Global::Storage(Dtype::F32),
            ("torch", "DoubleStorage") => Global::Storage(Dtype::F64),
            ("torch", other) if other.ends_with("Storage") => {
                return Err(Rule::StorageType { found: clipped(other) });
            }
            (module, name) => return Err(Rule::Global { name: clipped(&format!("{module} {name}")) }),
        };
        self.stack.push(Value::Global(global));
        Ok(())
    }

    /// REDUCE: a function and the tuple of its arguments.
    pub(super) fn call(&mut self, position: usize) -> Result<()> {
        let arguments = self.pop(position)?;
        let function = self.pop(position)?;
        let Value::Tuple(arguments) = arguments else {
            return Err(Rule::Operand { at: position, expected: "tuple", found: arguments.type_name() });
        };
        let result = match function {
            Value::Global(Global::RebuildTensor) => self.tensor(position, arguments)?,
            Value::Global(Global::OrderedDict) if arguments.length == 0 => self.new_dict(),
            Value::Global(Global::OrderedDict) => self.dict_of_pairs(position, arguments)?,
            Value::Global(Global::RebuildParameter) => match self.pools.tuples[arguments.range()] {
                [tensor @ Value::Tensor(_), _, _] => tensor,
                _ => return Err(Rule::Call { at: position, what: "_rebuild_parameter" }),
            },
            other => {
                return Err(Rule::Operand {
                    at: position,
                    expected: "a function that is read",
                    found: other.type_name(),
                });
            }
        };
        self.stack.push(result);
        Ok(())
    }

    /// `OrderedDict([[key, value], …])`, as Python 2 wrote it.
    fn dict_of_pairs(&mut self, position: usize, arguments: Span) -> Result<Value> {
        let wrong = Rule::Call { at: position, what: "OrderedDict" };
        let [Value::List(list)] = self.pools.tuples[arguments.range()] else { return Err(wrong) };
        // The list is given up for it, or one that is referred to often would be stored as often.
        let list = std::mem::take(&mut self.pools.lists[list as usize]);
        let pairs = list.into_iter().map(|pair| match self.pools.items(pair) {
            Some(&[key, value]) => Some((key, value)),
            _ => None,
        });
        let pairs = pairs.collect::<Option<Vec<_>>>().ok_or(wrong)?;
        self.pools.dicts.push(pairs);
        Ok(Value::Dict(self.pools.dicts.len() as u32 - 1))
    }

    /// BUILD: attributes of an object. Those that state dictionaries have (`_metadata`) are of no account.
    pub(super) fn attributes(&mut self, position: usize) -> Result<()> {
        match (self.pop(position)?, self.top(position)?) {
            (Value::Dict(_), Value::Dict(_)) => Ok(()),
            (Value::Dict(_), other) | (other, _) => {
                Err(Rule::Operand { at: position, expected: "dict", found: other.type_name() })
            }
        }
    }

    /// `_rebuild_tensor_v2(storage, offset, size, stride, requires_grad, hooks)`; newer files add metadata, and
    /// `_rebuild_tensor` of the oldest ends with the stride.
    fn tensor(&mut self, position: usize, arguments: Span) -> Result<Value> {
        let wrong = Rule::Call { at: position, what: "_rebuild_tensor_v2" };
        let (storage, offset, sizes, strides) = match self.pools.tuples[arguments.range()] {
            [Value::Storage(storage), Value::Int(offset), Value::Tuple(sizes), Value::Tuple(strides)]
            | [
                Value::Storage(storage),
                Value::Int(offset),
                Value::Tuple(sizes),
                Value::Tuple(strides),
                _,
                _,
            ]
            | [
                Value::Storage(storage),
                Value::Int(offset),
                Value::Tuple(sizes),
                Value::Tuple(strides),
                _,
                _,
                _,
            ] => (self.pools.storages[storage as usize], offset, sizes, strides),
            _ => return Err(wrong),
        };
        let dimensions = sizes.length as usize;
        if dimensions > super::MAX_DIMENSIONS {
            return Err(Rule::Dimensions { at: position, found: dimensions });
        }
        if sizes.length != strides.length {
            return Err(wrong);
        }
        let beyond = || Rule::TensorRange { at: position, elements: storage.elements };
        let natural = |value: &Value| match *value {
            Value::Int(number) => u64::try_from(number).map_err(|_| beyond()),
            _ => Err(Rule::Call { at: position, what: "_rebuild_tensor_v2" }),
        };
        let numbers = |span: Span| {
            let mut numbers = [0; super::MAX_DIMENSIONS];
            for (number, value) in numbers.iter_mut().zip(&self.pools.tuples[span.range()]) {
                *number = natural(value)?;
            }
            Ok(numbers)
        };
        let (sizes, strides) = (numbers(sizes)?, numbers(strides)?);
        let offset = natural(&Value::Int(offset))?;
        // One past the last element; a tensor without elements reaches as far as its offset.
        let mut end = offset;
        if !sizes[..dimensions].contains(&0) {
            for (size, stride) in sizes[..dimensions].iter().zip(&strides) {
                let reach = (size - 1).checked_mul(*stride).and_then(|reach| reach.checked_add(end));
                end = reach.ok_or_else(beyond)?;
            }
            end = end.checked_add(1).ok_or_else(beyond)?;
        }
        if end > storage.elements {
            return Err(beyond());
        }
        self.pools.tensors.push(Tensor { storage, offset, sizes, strides, dimensions });
        Ok(Value::Tensor(self.pools.tensors.len() as u32 - 1))
    }

    /// BINPERSID of `("storage", type, key, location, elements)`, and before 1.6 a view of it, which is always none.
    /// Where the tensor lived (`cpu`, `cuda:0`) is of no account.
    pub(super) fn persistent(&mut self, position: usize) -> Result<()> {
        let wrong = Rule::Call { at: position, what: "a storage" };
        let Value::Tuple(id) = self.pop(position)? else { return Err(wrong) };
        let (kind, dtype, key, elements) = match self.pools.tuples[id.range()] {
            [kind, Value::Global(Global::Storage(dtype)), Value::Text(key), _, Value::Int(elements)]
            | [
                kind,
                Value::Global(Global::Storage(dtype)),
                Value::Text(key),
                _,
                Value::Int(elements),
                Value::None,
            ] => (kind, dtype, key, elements),
            _ => return Err(wrong),
        };
        let (Some("storage"), Ok(elements)) = (self.pools.text(kind), u64::try_from(elements)) else {
            return Err(wrong);
        };
        self.pools.storages.push(Storage { dtype, key, elements });
        self.stack.push(Value::Storage(self.pools.storages.len() as u32 - 1));
        Ok(())
    }
}

/// A name of the file, cut to what fits into a message.
fn clipped(name: &str) -> String {
    name.chars().take(100).collect()
}
