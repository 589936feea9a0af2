//! Values: in the 8 bytes of a field where they fit, else each once in the file; integers coded.

use std::borrow::Cow;
use std::io::{self, Write};

use super::super::layer::{Arc, Value};
use super::super::usda::unorm4;
use super::{Crate, Kind, Rep, coding, counted, place};

/// Shorter arrays of integers are not compressed.
const COMPRESSED_FROM: usize = 16;
/// Bytes that converted arrays are written in.
const BLOCK: usize = 1 << 16;
/// How a list op begins.
const EXPLICIT: u8 = 0b11;
const PREPENDED: u8 = 0b10_0000;

impl<'l, W: Write> Crate<'l, W> {
    pub(super) fn value(&mut self, value: &'l Value<'l>) -> io::Result<Rep> {
        match value {
            Value::Bool(b) => Ok(Rep::inlined(Kind::Bool, u32::from(*b))),
            Value::Int(i) => Ok(Rep::inlined(Kind::Int, *i as u32)),
            Value::Float(f) => Ok(Rep::inlined(Kind::Float, f.to_bits())),
            Value::Double(d) if f64::from(*d as f32) == *d => {
                Ok(Rep::inlined(Kind::Double, (*d as f32).to_bits()))
            }
            Value::Double(d) => self.small(Kind::Double, d.to_le_bytes().to_vec()),
            Value::String(text) => {
                let string = self.string(text.as_ref());
                Ok(Rep::inlined(Kind::String, string))
            }
            Value::Token(text) => {
                let token = self.token(text.as_ref());
                Ok(Rep::inlined(Kind::Token, token))
            }
            Value::Asset(path) => {
                let token = self.token(path.as_str());
                Ok(Rep::inlined(Kind::Asset, token))
            }
            Value::Float3(v) => self.vector(Kind::Float3, v, f32::to_le_bytes),
            Value::Float4(v) => self.vector(Kind::Float4, v, f32::to_le_bytes),
            Value::Double3(v) => self.vector(Kind::Double3, v, f64::to_le_bytes),
            Value::Dictionary(entries) => self.dictionary(entries),
            Value::Prepended(names) => {
                let tokens: Vec<u32> = names.iter().map(|name| self.token(*name)).collect();
                self.small(Kind::TokenListOp, prepended(&tokens, u32::to_le_bytes))
            }
            Value::Selections(chosen) => {
                let mut bytes = (chosen.len() as u64).to_le_bytes().to_vec();
                for (set, variant) in chosen {
                    bytes.extend(self.string(*set).to_le_bytes());
                    bytes.extend(self.string(variant.as_str()).to_le_bytes());
                }
                self.small(Kind::Selections, bytes)
            }
            // Metadata alone, which `metadata` writes.
            Value::Arc(arc) => self.arc("references", arc),
            Value::Ints(items) => self.array(Kind::Int, value, items.len()),
            Value::Repeated(_, count) => self.array(Kind::Int, value, *count),
            Value::Int64s(items) => self.array(Kind::Int64, value, items.len()),
            Value::Floats(items) => self.array(Kind::Float, value, items.len()),
            Value::Float2s(items) => self.array(Kind::Float2, value, items.len()),
            Value::Float3s(items) => self.array(Kind::Float3, value, items.len()),
            Value::Unorm4s(items) => self.array(Kind::Float4, value, items.len()),
            Value::Quatfs(items) => self.array(Kind::Quatf, value, items.len()),
            Value::Quaths(items) => self.array(Kind::Quath, value, items.len()),
            Value::Strings(items) => self.array(Kind::String, value, items.len()),
        }
    }

    /// Written once, however often it is asked for.
    pub(super) fn small(&mut self, kind: Kind, bytes: Vec<u8>) -> io::Result<Rep> {
        if let Some(rep) = self.small.get(&(kind, bytes.clone())) {
            return Ok(*rep);
        }
        let rep = Rep::at(kind, self.at);
        self.bytes(&bytes)?;
        self.small.insert((kind, bytes), rep);
        Ok(rep)
    }

    /// In a byte a number where all are whole and fit.
    fn vector<T: Copy + Into<f64>, const N: usize, const B: usize>(
        &mut self,
        kind: Kind,
        numbers: &[T; N],
        le: impl Fn(T) -> [u8; B],
    ) -> io::Result<Rep> {
        let short = numbers.map(|n| n.into() as i8);
        if short.iter().zip(numbers).all(|(s, n)| f64::from(*s) == (*n).into()) {
            let mut payload = [0; 4];
            for (byte, s) in payload.iter_mut().zip(short) {
                *byte = s as u8;
            }
            return Ok(Rep::inlined(kind, u32::from_le_bytes(payload)));
        }
        self.small(kind, numbers.iter().flat_map(|n| le(*n)).collect())
    }

    fn dictionary(&mut self, entries: &'l [(Cow<'l, str>, Value<'l>)]) -> io::Result<Rep> {
        if entries.is_empty() {
            return Ok(Rep::inlined(Kind::Dictionary, 0));
        }
        let mut bytes = (entries.len() as u64).to_le_bytes().to_vec();
        for (key, value) in entries {
            let rep = self.value(value)?;
            bytes.extend(self.string(key.as_ref()).to_le_bytes());
            // From here to the value: what it is made of could stand between.
            bytes.extend(8i64.to_le_bytes());
            bytes.extend(rep.0.to_le_bytes());
        }
        self.small(Kind::Dictionary, bytes)
    }

    pub(super) fn arc(&mut self, name: &str, arc: &'l Arc) -> io::Result<Rep> {
        let mut item = Vec::new();
        item.extend(self.string(arc.asset.as_str()).to_le_bytes());
        item.extend(self.path(&arc.prim).to_le_bytes());
        // No shift in time.
        item.extend(0f64.to_le_bytes());
        item.extend(1f64.to_le_bytes());
        let kind = if name == "payload" {
            Kind::PayloadListOp
        } else {
            // No entries of its own.
            item.extend(0u64.to_le_bytes());
            Kind::ReferenceListOp
        };
        let mut bytes = vec![PREPENDED];
        bytes.extend(1u64.to_le_bytes());
        bytes.extend(item);
        self.small(kind, bytes)
    }

    pub(super) fn targets(&mut self, paths: &'l [String]) -> io::Result<Rep> {
        let numbers: Vec<u32> = paths.iter().map(|path| self.path(path)).collect();
        let mut bytes = vec![EXPLICIT];
        bytes.extend(counted(&numbers, u32::to_le_bytes));
        self.small(Kind::PathListOp, bytes)
    }

    fn array(&mut self, kind: Kind, value: &'l Value<'l>, count: usize) -> io::Result<Rep> {
        if count == 0 {
            return Ok(Rep::array(kind, 0));
        }
        let key = (kind, sample(value));
        if let Some(known) = self.arrays.get(&key)
            && let Some((_, rep)) =
                known.iter().find(|(other, _)| std::ptr::eq(*other, value) || *other == value)
        {
            return Ok(*rep);
        }
        let rep = self.new_array(kind, value, count)?;
        self.arrays.entry(key).or_default().push((value, rep));
        Ok(rep)
    }

    fn new_array(&mut self, kind: Kind, value: &'l Value<'l>, count: usize) -> io::Result<Rep> {
        self.align()?;
        let rep = Rep::array(kind, self.at);
        self.bytes(&(count as u64).to_le_bytes())?;
        let integers = match self.coded.remove(&place(value)) {
            _ if count < COMPRESSED_FROM => None,
            None => integer_bytes(value),
            coded => coded,
        };
        if let Some(integers) = integers {
            self.bytes(&(integers.len() as u64).to_le_bytes())?;
            self.bytes(&integers)?;
            return Ok(Rep(rep.0 | Rep::COMPRESSED));
        }
        match value {
            Value::Ints(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Repeated(item, count) => {
                self.bytes(bytemuck::cast_slice(&vec![*item; *count]))?;
            }
            Value::Int64s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Floats(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Float2s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Float3s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Unorm4s(items) => self.converted(items, |v| unorm4(v).map(f32::to_le_bytes))?,
            // The real part is last here.
            Value::Quatfs(items) => {
                self.converted(items, |[r, i, j, k]| [*i, *j, *k, *r].map(f32::to_le_bytes))?;
            }
            Value::Quaths(items) => {
                let half = |v: f32| half_bits(v).to_le_bytes();
                self.converted(items, |[r, i, j, k]| [*i, *j, *k, *r].map(half))?;
            }
            Value::Strings(items) => {
                let numbers: Vec<u32> = items.iter().map(|s| self.string(s.as_ref())).collect();
                self.bytes(bytemuck::cast_slice(&numbers))?;
            }
            _ => {}
        }
        Ok(rep)
    }

    fn converted<T, const B: usize>(
        &mut self,
        items: &[T],
        convert: impl Fn(&T) -> [[u8; B]; 4],
    ) -> io::Result<()> {
        let mut numbers: Vec<[[u8; B]; 4]> = Vec::new();
        for block in items.chunks(BLOCK / (4 * B)) {
            numbers.clear();
            numbers.extend(block.iter().map(&convert));
            self.bytes(numbers.as_flattened().as_flattened())?;
        }
        Ok(())
    }
}

pub(super) fn integer_bytes(value: &Value) -> Option<Vec<u8>> {
    match value {
        Value::Ints(items) => Some(coding::ints(items)),
        Value::Repeated(item, count) => Some(coding::repeated(*item, *count)),
        Value::Int64s(items) => Some(coding::long_ints(items)),
        _ => None,
    }
}

pub(super) fn prepended(items: &[u32], le: impl Fn(u32) -> [u8; 4]) -> Vec<u8> {
    let mut out = vec![PREPENDED];
    out.extend(counted(items, le));
    out
}

/// Of an array: its length and up to 64 of its items; equal ones have equal samples.
fn sample(value: &Value) -> u64 {
    fn of<T: bytemuck::Pod>(items: &[T]) -> u64 {
        let step = items.len().div_ceil(64).max(1);
        let sampled = items.iter().step_by(step).flat_map(|item| bytemuck::bytes_of(item));
        hash(sampled.copied(), items.len())
    }
    match value {
        Value::Ints(items) => of(items),
        Value::Repeated(item, count) => hash(item.to_le_bytes(), *count),
        Value::Int64s(items) => of(items),
        Value::Floats(items) => of(items),
        Value::Float2s(items) => of(items),
        Value::Float3s(items) => of(items),
        Value::Unorm4s(items) => of(items),
        Value::Quatfs(items) | Value::Quaths(items) => of(items),
        Value::Strings(items) => hash(items.iter().take(8).flat_map(|s| s.bytes()), items.len()),
        _ => 0,
    }
}

/// FNV-1a.
fn hash(bytes: impl IntoIterator<Item = u8>, length: usize) -> u64 {
    let start = 0xCBF2_9CE4_8422_2325 ^ length as u64;
    bytes.into_iter().fold(start, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01B3))
}

/// The nearest half float, ties to even.
fn half_bits(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16 & 0x8000) as u16;
    let exponent = (bits >> 23 & 0xFF) as i32 - 112;
    let fraction = bits & 0x7F_FFFF;
    if exponent >= 0x1F {
        // Too large, infinite, or no number.
        let is_nan = exponent == 0xFF - 112 && fraction != 0;
        return sign | 0x7C00 | u16::from(is_nan) << 9;
    }
    // Below the normal range the leading one is written out, and shifted down.
    let (significand, shift) = match exponent {
        1.. => ((exponent as u32) << 23 | fraction, 13),
        -10..=0 => (fraction | 0x80_0000, (14 - exponent) as u32),
        _ => return sign,
    };
    let (whole, rest, tie) =
        (significand >> shift, significand & ((1 << shift) - 1), 1 << (shift - 1));
    let up = rest > tie || (rest == tie && whole & 1 == 1);
    sign | (whole + u32::from(up)) as u16
}
