//! A pool of buffers, which are reused by the next frame.

use rayon::prelude::*;
use std::num::NonZeroU64;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

/// What a buffer is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Use {
    /// Read and written by passes, filled and read by copies.
    Storage,
    /// A few numbers for a pass.
    Uniform,
    /// Copied to, and read by the CPU.
    Readback,
}

/// Bytes that a thread copies at a time: one thread does not reach the bandwidth of the memory.
pub(super) const CHUNK: usize = 1 << 18;

/// Free buffers that are kept at most; the oldest goes first.
const FREE_MAX: usize = 64;

/// A set of free buffers; clones share it.
#[derive(Debug, Clone)]
pub(super) struct Pool {
    device: wgpu::Device,
    queue: wgpu::Queue,
    /// Whether buffers are filled with NaN before use, so that nobody relies on what is in them.
    poison: bool,
    free: Arc<Mutex<Vec<(Use, wgpu::Buffer)>>>,
}

/// A buffer on loan from a pool.
#[derive(Debug)]
pub(super) struct Pooled {
    usage: Use,
    /// Bytes asked for; the buffer may be larger.
    bytes: u64,
    buffer: wgpu::Buffer,
    home: Arc<Mutex<Vec<(Use, wgpu::Buffer)>>>,
}

impl Pool {
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue, poison: bool) -> Self {
        Self { device: device.clone(), queue: queue.clone(), poison, free: Arc::default() }
    }

    /// A buffer of at least `bytes` bytes (and at least 4, a multiple of 4) with anything in it.
    pub(super) fn take(&self, usage: Use, bytes: u64) -> Pooled {
        let bytes = bytes.max(4).next_multiple_of(4);
        // Sizes in steps of an eighth, so that a frame that needs a little more finds room.
        let step = (bytes.next_power_of_two() / 8).max(256);
        let size = bytes.next_multiple_of(step).min(self.device.limits().max_buffer_size).max(bytes);
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |(other, buffer): &(Use, wgpu::Buffer)| {
            *other == usage && (size..=2 * size).contains(&buffer.size())
        };
        let buffer = match free.iter().position(fits) {
            Some(place) => free.remove(place).1,
            None => self.device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size,
                usage: match usage {
                    Use::Storage => {
                        wgpu::BufferUsages::STORAGE
                            | wgpu::BufferUsages::COPY_SRC
                            | wgpu::BufferUsages::COPY_DST
                    }
                    Use::Uniform => wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                    Use::Readback => wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                },
                mapped_at_creation: false,
            }),
        };
        drop(free);
        if self.poison && usage == Use::Storage {
            self.queue.write_buffer(&buffer, 0, &vec![0xff; buffer.size() as usize]);
        }
        Pooled { usage, bytes, buffer, home: Arc::clone(&self.free) }
    }

    /// Drops what is free.
    pub(super) fn forget(&self) {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Whether a buffer is of this pool.
    pub(super) fn owns(&self, buffer: &Pooled) -> bool {
        Arc::ptr_eq(&self.free, &buffer.home)
    }

    /// A storage buffer with `data` in it, copied on all threads.
    pub(super) fn storage<T: bytemuck::Pod>(&self, data: &[T]) -> Pooled {
        let buffer = self.take(Use::Storage, size_of_val(data) as u64);
        let bytes: &[u8] = bytemuck::cast_slice(data);
        // Where a buffer cannot be written the device has told so, and the next submission fails.
        let view = NonZeroU64::new(bytes.len() as u64)
            .and_then(|size| self.queue.write_buffer_with(&buffer, 0, size));
        if let Some(mut view) = view {
            let (parts, mut rest) = view.slice(..).into_chunks::<CHUNK>();
            let (chunks, others) = bytes.as_chunks::<CHUNK>();
            let parts: Vec<_> = parts.into_iter().zip(chunks).collect();
            parts
                .into_par_iter()
                .for_each(|(part, chunk)| wgpu::WriteOnly::from(part).copy_from_slice(chunk));
            rest.copy_from_slice(others);
        }
        buffer
    }

    /// A uniform buffer with `data` in it.
    pub(super) fn uniform<T: bytemuck::Pod>(&self, data: &T) -> Pooled {
        let buffer = self.take(Use::Uniform, size_of::<T>() as u64);
        self.queue.write_buffer(&buffer, 0, bytemuck::bytes_of(data));
        buffer
    }

    /// A uniform buffer with `rows` in it, written at once.
    pub(super) fn uniform_rows(&self, rows: &[[u32; 4]]) -> UniformRows {
        let stride = u64::from(self.device.limits().min_uniform_buffer_offset_alignment);
        let mut bytes = vec![0; rows.len() * stride as usize];
        for (place, row) in bytes.chunks_exact_mut(stride as usize).zip(rows) {
            place[..size_of_val(row)].copy_from_slice(bytemuck::bytes_of(row));
        }
        let buffer = self.take(Use::Uniform, bytes.len() as u64);
        self.queue.write_buffer(&buffer, 0, &bytes);
        UniformRows { buffer, stride }
    }
}

/// Rows of a uniform buffer, each where a binding may begin.
pub(super) struct UniformRows {
    pub(super) buffer: Pooled,
    stride: u64,
}

impl UniformRows {
    /// One row.
    pub(super) fn row(&self, row: usize) -> wgpu::BufferBinding<'_> {
        let size = NonZeroU64::new(size_of::<[u32; 4]>() as u64);
        wgpu::BufferBinding { buffer: &self.buffer, offset: row as u64 * self.stride, size }
    }
}

impl Pooled {
    /// Bytes asked for.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// What was asked for, as a binding.
    pub(super) fn whole(&self) -> wgpu::BufferBinding<'_> {
        wgpu::BufferBinding { buffer: &self.buffer, offset: 0, size: NonZeroU64::new(self.bytes) }
    }
}

impl Deref for Pooled {
    type Target = wgpu::Buffer;

    fn deref(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

impl Drop for Pooled {
    fn drop(&mut self) {
        let mut free = self.home.lock().unwrap_or_else(PoisonError::into_inner);
        if free.len() == FREE_MAX {
            free.remove(0);
        }
        free.push((self.usage, self.buffer.clone()));
    }
}
