//! Choice of a GPU, and the check of its capabilities.

use super::{Gpu, GpuError};

/// Which adapter to open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GpuChoice<'a> {
    /// The first hardware GPU, discrete ones before integrated ones.
    Hardware,
    /// The first adapter whose name contains this text, in upper or lower case; software adapters too.
    Named(&'a str),
}

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    // Indirect arguments are written by our shaders within the limits; checking them would cost a dispatch each.
    descriptor.flags =
        if cfg!(debug_assertions) { wgpu::InstanceFlags::VALIDATION } else { wgpu::InstanceFlags::empty() };
    wgpu::Instance::new(descriptor)
}

fn adapters() -> Vec<wgpu::Adapter> {
    let mut adapters = pollster::block_on(instance().enumerate_adapters(wgpu::Backends::PRIMARY));
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    adapters
}

/// Purpose of an open adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    /// Everything, within what the adapter allows.
    Training,
    /// Forward alone, within what every browser allows.
    Viewing,
}

impl Gpu {
    /// Opens an adapter for training and drawing, with all limits that it allows.
    ///
    /// ```no_run
    /// use tcgs_render::gpu::{Gpu, GpuChoice, GpuRasterizer};
    /// let gpu = Gpu::open(GpuChoice::Hardware)?;
    /// let rasterizer = GpuRasterizer::new(&gpu);
    /// # Ok::<(), tcgs_render::gpu::GpuError>(())
    /// ```
    ///
    /// # Errors
    /// [`GpuError::NotFound`] if no adapter matches, [`GpuError::Unfit`] if it cannot run the shaders.
    pub fn open(choice: GpuChoice<'_>) -> Result<Self, GpuError> {
        Self::open_for(choice, Purpose::Training)
    }

    /// Opens an adapter as a browser does: for drawing without gradients, within the limits that every browser grants.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_for_viewing(choice: GpuChoice<'_>) -> Result<Self, GpuError> {
        Self::open_for(choice, Purpose::Viewing)
    }

    fn open_for(choice: GpuChoice<'_>, purpose: Purpose) -> Result<Self, GpuError> {
        let adapters = adapters();
        let is_wanted = |adapter: &&wgpu::Adapter| {
            let info = adapter.get_info();
            match choice {
                GpuChoice::Hardware => info.device_type != wgpu::DeviceType::Cpu,
                GpuChoice::Named(name) => info.name.to_lowercase().contains(&name.to_lowercase()),
            }
        };
        let mut problem = None;
        for adapter in adapters.iter().filter(is_wanted) {
            let limits = match purpose {
                Purpose::Training => adapter.limits(),
                Purpose::Viewing => wgpu::Limits::default(),
            };
            match pollster::block_on(Self::of_adapter(adapter, purpose, limits)) {
                Ok(gpu) => return Ok(gpu),
                // The next adapter may fit; if none does, the best one's error is returned.
                Err(error) => problem = problem.or(Some(error)),
            }
        }
        Err(problem.unwrap_or_else(|| {
            let names: Vec<String> = adapters.iter().map(|adapter| describe(&adapter.get_info())).collect();
            GpuError::NotFound {
                wanted: match choice {
                    GpuChoice::Hardware => "in hardware".into(),
                    GpuChoice::Named(name) => format!("named {name}"),
                },
                found: if names.is_empty() { "none".into() } else { names.join(", ") },
            }
        }))
    }

    /// Opens the browser's GPU for a canvas. Buffers may exceed the limits of every browser if this one allows more.
    ///
    /// - returns: the GPU, the canvas' surface, not configured yet, and the format that suits it best
    ///
    /// # Errors
    /// [`GpuError::NotFound`] if there is no WebGPU, [`GpuError::Unfit`] if it cannot run the shaders.
    #[doc(hidden)]
    #[cfg(target_family = "wasm")]
    pub async fn of_canvas(
        canvas: wgpu::web_sys::HtmlCanvasElement,
    ) -> Result<(Self, wgpu::Surface<'static>, wgpu::TextureFormat), GpuError> {
        let missing = |found: String| GpuError::NotFound { wanted: "through WebGPU".into(), found };
        let instance = instance();
        let surface = instance
            .create_surface(wgpu::SurfaceTarget::Canvas(canvas))
            .map_err(|error| missing(format!("a canvas without it: {error}")))?;
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..Default::default()
        };
        let adapter = instance.request_adapter(&options).await.map_err(|_| missing("none".into()))?;
        // Colours are stored as displayed, so the format must not encode them.
        let formats = surface.get_capabilities(&adapter).formats;
        let format = formats.into_iter().find(|format| !format.is_srgb()).unwrap_or(wgpu::TextureFormat::Bgra8Unorm);
        let limits = adapter.limits();
        Ok((Self::of_adapter(&adapter, Purpose::Viewing, limits).await?, surface, format))
    }

    async fn of_adapter(
        adapter: &wgpu::Adapter,
        purpose: Purpose,
        required_limits: wgpu::Limits,
    ) -> Result<Self, GpuError> {
        let about = adapter.get_info();
        let unfit = |problem: String| GpuError::Unfit { name: about.name.clone(), problem };
        if !adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS) {
            return Err(unfit("has no compute shaders".into()));
        }
        if let Some(problem) = lacking(&adapter.limits(), purpose) {
            return Err(unfit(problem));
        }
        let wanted = match purpose {
            Purpose::Training => wgpu::Features::TIMESTAMP_QUERY,
            Purpose::Viewing => wgpu::Features::empty(),
        };
        let features = adapter.features() & wanted;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("tcgs"),
            required_features: features,
            required_limits,
            ..Default::default()
        };
        let (device, queue) =
            adapter.request_device(&descriptor).await.map_err(|e| unfit(format!("cannot be opened: {e}")))?;
        Ok(Self::of_device(&about, features, device, queue))
    }
}

/// The first requirement of the shaders that an adapter does not meet.
fn lacking(limits: &wgpu::Limits, purpose: Purpose) -> Option<String> {
    let storage_buffers = match purpose {
        Purpose::Training => 10,
        Purpose::Viewing => 8,
    };
    let needed = [
        ("storage buffers in a shader", limits.max_storage_buffers_per_shader_stage, storage_buffers),
        ("bindings in a group", limits.max_bindings_per_bind_group, 20),
        ("bytes of memory in a workgroup", limits.max_compute_workgroup_storage_size, 16_384),
        ("threads in a workgroup", limits.max_compute_invocations_per_workgroup, 256),
        ("threads along a workgroup", limits.max_compute_workgroup_size_x, 256),
        ("workgroups along a dispatch", limits.max_compute_workgroups_per_dimension, 65_535),
    ];
    let lacking: Vec<String> = needed
        .into_iter()
        .filter(|(_, found, expected)| found < expected)
        .map(|(what, found, expected)| format!("allows {found} {what}, expected at least {expected}"))
        .collect();
    (!lacking.is_empty()).then(|| lacking.join("; "))
}

fn describe(info: &wgpu::AdapterInfo) -> String {
    let kind = if info.device_type == wgpu::DeviceType::Cpu { "software, only by name" } else { "hardware" };
    format!("{} ({}, {kind})", info.name, info.backend)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_every_browser_has_is_enough_for_viewing() {
        assert_eq!(lacking(&wgpu::Limits::default(), Purpose::Viewing), None);
    }

    #[test]
    fn what_an_adapter_lacks_is_named() {
        let enough = wgpu::Limits { max_storage_buffers_per_shader_stage: 10, ..wgpu::Limits::default() };
        assert_eq!(lacking(&enough, Purpose::Training), None);
        let few = wgpu::Limits { max_compute_workgroup_size_x: 128, ..wgpu::Limits::default() };
        let expected = "allows 8 storage buffers in a shader, expected at least 10; \
                        allows 128 threads along a workgroup, expected at least 256";
        assert_eq!(lacking(&few, Purpose::Training).as_deref(), Some(expected));
    }
}
