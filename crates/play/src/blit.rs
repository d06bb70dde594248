//! Copies the image in the renderer's buffer to a texture that a window can show.

use bytemuck::{Pod, Zeroable};
use tcgs_render::gpu::{Gpu, GpuError};

/// WGSL of the shaders.
pub(crate) const SOURCE: &str = include_str!("blit.wgsl");

/// Mirrors `Picture` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Picture {
    light: [f32; 3],
    size: [u32; 2],
    unused: [u32; 3],
}

/// Copies images to textures of one format.
#[derive(Debug)]
pub struct Blit {
    pipeline: wgpu::RenderPipeline,
    picture: wgpu::Buffer,
}

impl Blit {
    /// Compiles the shaders.
    ///
    /// - `format`: format of the textures. It must not encode sRGB, because colours are stored as displayed
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
        Ok(Self { pipeline, picture: gpu.uniform("picture", size_of::<Picture>())? })
    }

    /// Records a pass that copies an image to a texture.
    ///
    /// - `image`: `[C + 1, H, W]`, as the renderer leaves it
    /// - `size`: width and height of both the image and `target`, pixels
    /// - `light`: gains of red, green and blue
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        image: &wgpu::Buffer,
        size: [usize; 2],
        light: [f32; 3],
        target: &wgpu::TextureView,
    ) {
        let picture = Picture { light, size: size.map(|pixels| pixels as u32), unused: [0; 3] };
        gpu.queue().write_buffer(&self.picture, 0, bytemuck::bytes_of(&picture));
        let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("blit"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.picture.as_entire_binding() },
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
