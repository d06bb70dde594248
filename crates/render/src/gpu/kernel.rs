//! Compute shaders: a [`Kernel`] is compiled; a [`Bound`] is a kernel with its buffers and can be dispatched.

use crate::device::{groups_in_rows, groups_over};

/// A compiled compute function of a shader.
#[derive(Clone, Debug)]
pub struct Kernel {
    pipeline: wgpu::ComputePipeline,
    label: &'static str,
}

impl Kernel {
    pub(super) fn compile(device: &wgpu::Device, source: &str, entry: &'static str) -> Self {
        let descriptor =
            wgpu::ShaderModuleDescriptor { label: Some(entry), source: wgpu::ShaderSource::Wgsl(source.into()) };
        let module = device.create_shader_module(descriptor);
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        Self { pipeline, label: entry }
    }

    /// Binds the function to its buffers.
    ///
    /// - `buffers`: bindings of group 0 that this entry point uses, each once
    pub fn bind(&self, device: &wgpu::Device, buffers: &[(u32, &wgpu::Buffer)]) -> Bound {
        let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
            .iter()
            .map(|&(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.label),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        Bound { pipeline: self.pipeline.clone(), group }
    }
}

/// A compute function with its buffers.
#[derive(Clone, Debug)]
pub struct Bound {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

impl Bound {
    /// Records one dispatch of workgroups along x, y and z; none if a number is 0.
    pub fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, [x, y, z]: [u32; 3]) {
        if x * y * z == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(x, y, z);
    }

    /// Records one dispatch of `len` workgroups, in rows as in [`groups_in_rows`].
    pub fn dispatch_groups(&self, pass: &mut wgpu::ComputePass<'_>, len: usize) {
        self.dispatch(pass, groups_in_rows(len));
    }

    /// Records one dispatch with one thread for each of `len` elements, as in [`groups_over`].
    pub fn dispatch_over(&self, pass: &mut wgpu::ComputePass<'_>, len: usize) {
        self.dispatch(pass, groups_over(len));
    }

    /// Records one dispatch whose numbers of workgroups are three 32-bit values in `arguments`.
    ///
    /// - `offset`: bytes
    pub fn dispatch_indirect(&self, pass: &mut wgpu::ComputePass<'_>, arguments: &wgpu::Buffer, offset: u64) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups_indirect(arguments, offset);
    }
}
