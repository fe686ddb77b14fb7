//! A device with its pipelines: dispatches entry points, submits, reads back.

use super::adapter::{self, AdapterDescription, GpuOptions};
use super::pool::{CHUNK, Pool, Pooled, Use};
use crate::{Error, Result};
use gs_shaders::{Access, EntryPoint, Features, Pass};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, mpsc};

/// A GPU that is ready to run the passes.
#[derive(Debug)]
pub struct Gpu {
    pub(super) about: AdapterDescription,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) pool: Pool,
    /// Pairs of Gaussian and tile for which the last frame had room.
    pub(super) pair_capacity: u32,
    pipelines: Mutex<HashMap<PipelineKey, Arc<Pipeline>>>,
    /// The first error that no call returned.
    failure: Arc<Mutex<Option<wgpu::Error>>>,
}

/// Entry point, and the bits of its overrides.
type PipelineKey = (&'static str, Vec<u64>);

#[derive(Debug)]
struct Pipeline {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// A buffer of [`Gpu::run_pass`].
#[derive(Debug, Clone, Copy)]
pub enum PassBuffer<'a> {
    /// Holds these bytes before the pass.
    Bytes(&'a [u8]),
    /// The entry point does not use it.
    Unused,
}

/// Commands that have not been submitted, and the buffers that they need until then.
pub(super) struct Recording {
    encoder: wgpu::CommandEncoder,
    /// Open as long as dispatches follow each other: a compute pass of its own for each would take longer to record than to run.
    dispatches: Option<wgpu::ComputePass<'static>>,
    pub(super) keep: Vec<Pooled>,
}

impl Recording {
    /// The encoder, for what is no dispatch.
    pub(super) fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        self.dispatches = None;
        &mut self.encoder
    }

    fn dispatches(&mut self) -> &mut wgpu::ComputePass<'static> {
        self.dispatches
            .get_or_insert_with(|| self.encoder.begin_compute_pass(&Default::default()).forget_lifetime())
    }
}

impl Gpu {
    /// Starts the best adapter that comes into question.
    ///
    /// # Errors
    /// If there is none, it cannot be started, or it renders a tiny scene other than it should.
    pub fn new(options: &GpuOptions) -> Result<Self> {
        let mut failures = Vec::new();
        for adapter in adapter::choose(options.adapter)? {
            let tested = Self::untested(&adapter, options).and_then(|mut gpu| gpu.self_test().map(|()| gpu));
            match tested {
                Ok(gpu) => return Ok(gpu),
                Err(error) => failures.push(error),
            }
        }
        // That of the best adapter says most.
        Err(failures.swap_remove(0))
    }

    fn untested(adapter: &wgpu::Adapter, options: &GpuOptions) -> Result<Self> {
        let mut about = adapter::describe(adapter);
        let offered = adapter.limits();
        about.largest_binding = about.largest_binding.min(options.largest_binding.unwrap_or(u64::MAX));
        // WebGPU's defaults, but as much memory as there is.
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: about.largest_binding,
            max_buffer_size: offered.max_buffer_size,
            ..wgpu::Limits::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("gs-raster"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|source| Error::Device { adapter: about.name.clone(), source: Box::new(source) })?;
        let failure = Arc::new(Mutex::new(None));
        let seen = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |error| {
            seen.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
        }));
        let pool = Pool::new(&device, &queue, options.poison);
        Ok(Self { about, device, queue, pool, pair_capacity: 0, pipelines: Mutex::default(), failure })
    }

    /// The adapter that is used.
    #[must_use]
    pub fn adapter(&self) -> &AdapterDescription {
        &self.about
    }

    /// Runs one entry point on buffers given by number, and returns what is in them afterwards. For tests and for the
    /// developers of shaders; `groups` are the dispatch's dimensions.
    ///
    /// # Errors
    /// If a buffer is too large for the device, or the device fails.
    ///
    /// # Panics
    /// If the pass has no such entry point, or a buffer that it uses is not given.
    pub fn run_pass(
        &mut self,
        pass: &'static Pass,
        entry_point: &str,
        features: Features,
        groups: [u32; 2],
        buffers: &[PassBuffer],
    ) -> Result<Vec<Vec<u8>>> {
        let mut given: Vec<Option<Pooled>> = Vec::new();
        for (binding, buffer) in pass.bindings.iter().zip(buffers) {
            given.push(match buffer {
                PassBuffer::Unused => None,
                PassBuffer::Bytes(bytes) => {
                    self.check_size(binding.name, bytes.len() as u64)?;
                    Some(match binding.access {
                        Access::Uniform => {
                            let pooled = self.pool.take(Use::Uniform, bytes.len() as u64);
                            self.queue.write_buffer(&pooled, 0, bytes);
                            pooled
                        }
                        Access::Read | Access::ReadWrite => self.pool.storage(bytes),
                    })
                }
            });
        }
        let mut recording = self.recording();
        let bound: Vec<_> = given.iter().map(|buffer| buffer.as_ref().map(Pooled::whole)).collect();
        self.dispatch(&mut recording, pass, entry_point, features, groups, &bound);
        let mut staged = Vec::new();
        for (binding, buffer) in pass.bindings.iter().zip(&given) {
            staged.push(match buffer {
                Some(buffer) if binding.access == Access::ReadWrite => {
                    Some(self.stage(&mut recording, buffer))
                }
                _ => None,
            });
        }
        self.submit(recording)?;
        staged
            .iter()
            .zip(buffers)
            .map(|(staged, buffer)| match (staged, buffer) {
                (Some(staged), PassBuffer::Bytes(bytes)) => {
                    Ok(self.read::<u8>(staged)?[..bytes.len()].to_vec())
                }
                (_, PassBuffer::Bytes(bytes)) => Ok(bytes.to_vec()),
                (_, PassBuffer::Unused) => Ok(Vec::new()),
            })
            .collect()
    }

    /// An error that names the buffer if it does not fit the device.
    pub(super) fn check_size(&self, what: &'static str, bytes: u64) -> Result<()> {
        let limit = self.about.largest_binding;
        if bytes > limit { Err(Error::TooLargeForGpu { what, bytes, limit }) } else { Ok(()) }
    }

    pub(super) fn recording(&self) -> Recording {
        let encoder = self.device.create_command_encoder(&Default::default());
        Recording { encoder, dispatches: None, keep: Vec::new() }
    }

    /// Records one dispatch. `buffers` are those of the pass, by number; those that the entry point does not use are not
    /// looked at.
    pub(super) fn dispatch(
        &mut self,
        recording: &mut Recording,
        pass: &'static Pass,
        entry_point: &str,
        features: Features,
        groups: [u32; 2],
        buffers: &[Option<wgpu::BufferBinding<'_>>],
    ) {
        if groups.contains(&0) {
            return;
        }
        let entry_point = pass.entry_point(entry_point).expect("a pass is asked for its own entry points");
        let pipeline = self.pipeline(pass, entry_point, features);
        let entries: Vec<wgpu::BindGroupEntry> = entry_point
            .bindings
            .iter()
            .map(|&number| {
                let buffer = buffers[number as usize].clone();
                let buffer = buffer.expect("every buffer that an entry point uses is given");
                wgpu::BindGroupEntry { binding: number, resource: wgpu::BindingResource::Buffer(buffer) }
            })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(entry_point.name),
            layout: &pipeline.layout,
            entries: &entries,
        });
        let compute = recording.dispatches();
        compute.set_pipeline(&pipeline.pipeline);
        compute.set_bind_group(0, &group, &[]);
        compute.dispatch_workgroups(groups[0], groups[1], 1);
    }

    /// The pipeline of an entry point, compiled on first use.
    fn pipeline(
        &self,
        pass: &'static Pass,
        entry_point: &'static EntryPoint,
        features: Features,
    ) -> Arc<Pipeline> {
        let constants = pass.constants(features);
        let key = (entry_point.name, constants.iter().map(|(_, value)| value.to_bits()).collect());
        let mut pipelines = self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = pipelines.get(&key) {
            return Arc::clone(pipeline);
        }
        let entries: Vec<wgpu::BindGroupLayoutEntry> = entry_point
            .bindings
            .iter()
            .map(|&number| wgpu::BindGroupLayoutEntry {
                binding: number,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: match pass.bindings[number as usize].access {
                        Access::Uniform => wgpu::BufferBindingType::Uniform,
                        Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
                        Access::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let label = Some(entry_point.name);
        let layout = self
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label,
            source: wgpu::ShaderSource::Wgsl(pass.source().into()),
        });
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some(entry_point.name),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                zero_initialize_workgroup_memory: true,
            },
            cache: None,
        });
        let pipeline = Arc::new(Pipeline { pipeline, layout });
        pipelines.insert(key, Arc::clone(&pipeline));
        pipeline
    }

    /// Records a copy of a buffer to where the CPU can read it after submission.
    pub(super) fn stage(&self, recording: &mut Recording, buffer: &Pooled) -> Pooled {
        let staged = self.pool.take(Use::Readback, buffer.bytes());
        recording.encoder().copy_buffer_to_buffer(buffer, 0, &staged, 0, buffer.bytes());
        staged
    }

    pub(super) fn submit(&self, recording: Recording) -> Result<()> {
        let Recording { encoder, dispatches, keep: _keep } = recording;
        drop(dispatches);
        self.queue.submit([encoder.finish()]);
        self.failed()
    }

    /// What is in a staged buffer, once the GPU is done.
    pub(super) fn read<T: bytemuck::Pod>(&self, staged: &Pooled) -> Result<Vec<T>> {
        self.read_with(staged, bytemuck::pod_collect_to_vec)
    }

    /// Puts what is in a staged buffer into `numbers`, once the GPU is done: straight from where the GPU wrote it, on all threads.
    pub(super) fn read_into(&self, staged: &Pooled, numbers: &mut [f32]) -> Result<()> {
        let numbers: &mut [u8] = bytemuck::cast_slice_mut(numbers);
        self.read_with(staged, |bytes| {
            let parts = numbers.par_chunks_mut(CHUNK).zip(bytes.par_chunks(CHUNK));
            parts.for_each(|(numbers, bytes)| numbers.copy_from_slice(&bytes[..numbers.len()]));
        })
    }

    /// Shows what is in a staged buffer, once the GPU is done.
    pub(super) fn read_with<R>(&self, staged: &Pooled, look: impl FnOnce(&[u8]) -> R) -> Result<R> {
        let (send, receive) = mpsc::channel();
        staged.map_async(wgpu::MapMode::Read, 0..staged.bytes(), move |result| {
            // Nobody listens only if polling failed, which is reported below.
            let _ = send.send(result);
        });
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.failed()?;
        polled.map_err(|_| Error::DeviceLost { adapter: self.about.name.clone() })?;
        let lost = || Error::DeviceLost { adapter: self.about.name.clone() };
        receive.recv().map_err(|_| lost())?.map_err(|_| lost())?;
        let view = staged.get_mapped_range(0..staged.bytes()).map_err(|_| lost())?;
        let found = look(&view);
        drop(view);
        staged.unmap();
        Ok(found)
    }

    /// An error if anything failed that no call returned.
    pub(super) fn failed(&self) -> Result<()> {
        match self.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            None => Ok(()),
            Some(source) => {
                // What was made while it failed may be of no use; the next call makes it anew.
                self.pool.forget();
                self.pipelines.lock().unwrap_or_else(PoisonError::into_inner).clear();
                Err(Error::Gpu { adapter: self.about.name.clone(), source: Box::new(source) })
            }
        }
    }
}
