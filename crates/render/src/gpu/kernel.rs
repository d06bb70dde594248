//! Compute shaders: compiled once, bound to buffers, dispatched.

/// Threads of a workgroup wherever a shader has one thread an element.
pub const WORKGROUP: u32 = 256;

/// Most workgroups along x where a count of them may pass the limit of one dimension; the rest go along y.
pub const MAX_GROUPS_X: u32 = 32_768;

/// Most elements that have a thread each in one dispatch.
pub const MAX_THREADS: usize = 65_535 * WORKGROUP as usize;

/// A compiled compute shader.
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

    /// Ties the shader to its buffers.
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

/// A shader with its buffers.
#[derive(Clone, Debug)]
pub struct Bound {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
}

impl Bound {
    /// Records one dispatch.
    pub fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, [x, y, z]: [u32; 3]) {
        if x * y * z == 0 {
            return;
        }
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups(x, y, z);
    }

    /// Records one dispatch of `len` workgroups, of which each takes the number
    /// `workgroup_id.y * MAX_GROUPS_X + workgroup_id.x` and does nothing if that is not below `len`.
    pub fn dispatch_groups(&self, pass: &mut wgpu::ComputePass<'_>, len: usize) {
        let len = len as u32;
        self.dispatch(pass, [len.min(MAX_GROUPS_X), len.div_ceil(MAX_GROUPS_X), 1]);
    }

    /// Records one dispatch with a thread for each of `len` elements, in workgroups of [`WORKGROUP`]; at most
    /// [`MAX_THREADS`].
    pub fn dispatch_over(&self, pass: &mut wgpu::ComputePass<'_>, len: usize) {
        self.dispatch(pass, [(len as u32).div_ceil(WORKGROUP), 1, 1]);
    }

    /// Records one dispatch of as many workgroups as three 32-bit values of `arguments` say.
    ///
    /// - `offset`: bytes
    pub fn dispatch_indirect(&self, pass: &mut wgpu::ComputePass<'_>, arguments: &wgpu::Buffer, offset: u64) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.dispatch_workgroups_indirect(arguments, offset);
    }
}
