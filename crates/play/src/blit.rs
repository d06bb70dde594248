//! From the image in the renderer's buffer to a texture that a window can show.

use tcgs_render::gpu::{Gpu, GpuError};

/// WGSL of the shaders.
pub(crate) const SOURCE: &str = include_str!("blit.wgsl");

/// Copies images to textures of one format.
#[derive(Debug)]
pub struct Blit {
    pipeline: wgpu::RenderPipeline,
    size: wgpu::Buffer,
}

impl Blit {
    /// Compiles the shaders.
    ///
    /// - `format`: of the textures; not one that encodes sRGB, since colours are stored as displayed
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the GPU has no memory left.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Result<Self, GpuError> {
        let source = wgpu::ShaderSource::Wgsl(SOURCE.into());
        let module = gpu.device().create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("blit"), source });
        let pipeline = gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("blit"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("cover"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("show"),
                compilation_options: Default::default(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        Ok(Self { pipeline, size: gpu.uniform("size of the picture", 16)? })
    }

    /// Records a pass that copies an image to a texture.
    ///
    /// - `image`: `[C + 1, H, W]`, as the renderer leaves it
    /// - `size`: width and height of both the image and `target`, pixels
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        image: &wgpu::Buffer,
        [width, height]: [usize; 2],
        target: &wgpu::TextureView,
    ) {
        gpu.queue().write_buffer(&self.size, 0, bytemuck::cast_slice(&[width as u32, height as u32, 0, 0]));
        let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("blit"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.size.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: image.as_entire_binding() },
            ],
        });
        let mut pass = begin(encoder, target, wgpu::Color::BLACK);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Begins a render pass that first fills the texture with a colour.
pub(crate) fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    target: &wgpu::TextureView,
    color: wgpu::Color,
) -> wgpu::RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("blit"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(color), store: wgpu::StoreOp::Store },
        })],
        depth_stencil_attachment: None,
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    })
}
