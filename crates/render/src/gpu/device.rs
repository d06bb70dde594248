//! An open GPU: its description, and its first error. Its memory and its shaders are in `raw`.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, PoisonError};

use super::kernel::Kernel;
use crate::device::{GpuError, GpuInfo};

/// An open GPU, on which the renderer and the optimisation compute. Clones share one device.
#[derive(Clone, Debug)]
pub struct Gpu(pub(super) Arc<Inner>);

#[derive(Debug)]
pub(super) struct Inner {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    info: GpuInfo,
    /// The first error.
    problem: Arc<Mutex<Option<GpuError>>>,
    /// Keyed by source and entry point, so that nothing is compiled twice.
    pub kernels: Mutex<HashMap<(String, &'static str), Kernel>>,
    pub submissions: AtomicUsize,
    pub reads: AtomicUsize,
    pub compiled: AtomicUsize,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gpu {
    /// Wraps an open device and records its errors from then on.
    pub(super) fn of_device(
        about: &wgpu::AdapterInfo,
        features: wgpu::Features,
        device: wgpu::Device,
        queue: wgpu::Queue,
    ) -> Self {
        let problem = Arc::new(Mutex::new(None));
        let keep = |problem: &Mutex<Option<GpuError>>, error: GpuError| {
            let mut kept = lock(problem);
            // The loss is the cause of all later refusals, so it replaces them.
            if kept.is_none() || matches!(error, GpuError::Lost(_)) {
                *kept = Some(error);
            }
        };
        let of_errors = Arc::clone(&problem);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            keep(
                &of_errors,
                match error {
                    wgpu::Error::OutOfMemory { .. } => {
                        GpuError::Memory { what: "an operation".into(), bytes: 0, problem: "no memory is left".into() }
                    }
                    other => GpuError::Refused(other.to_string()),
                },
            );
        }));
        let of_loss = Arc::clone(&problem);
        device.set_device_lost_callback(move |reason, message| {
            let destroyed = reason == wgpu::DeviceLostReason::Destroyed;
            keep(&of_loss, GpuError::Lost(if destroyed { "it was closed".into() } else { message }));
        });
        let names = [(wgpu::Features::TIMESTAMP_QUERY, "timestamps")];
        let info = GpuInfo {
            name: about.name.clone(),
            driver: format!("{} {}", about.driver, about.driver_info).trim().into(),
            backend: about.backend.to_string(),
            is_software: about.device_type == wgpu::DeviceType::Cpu,
            features: names.iter().filter(|(f, _)| features.contains(*f)).map(|&(_, name)| name).collect(),
        };
        Self(Arc::new(Inner {
            device,
            queue,
            info,
            problem,
            kernels: Mutex::default(),
            submissions: AtomicUsize::new(0),
            reads: AtomicUsize::new(0),
            compiled: AtomicUsize::new(0),
        }))
    }

    /// Name, driver and features of the adapter.
    pub fn info(&self) -> &GpuInfo {
        &self.0.info
    }

    /// Fails if an error has occurred.
    ///
    /// # Errors
    /// The first error.
    pub fn check(&self) -> Result<(), GpuError> {
        let problem = || lock(&self.0.problem).clone().map_or(Ok(()), Err);
        problem().or_else(|error| {
            if matches!(error, GpuError::Refused(_)) {
                // A lost device may be reported only once it is idle, so a refusal may be due to the loss.
                let _ = self.poll_device(wgpu::PollType::wait_indefinitely());
            }
            problem()
        })
    }

    /// Waits until all submitted work is done.
    ///
    /// # Errors
    /// An error that occurred meanwhile.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.poll_until(wgpu::PollType::wait_indefinitely())
    }

    /// Lets callbacks of finished copies and of errors run; does not wait.
    ///
    /// # Errors
    /// An error that occurred meanwhile.
    pub fn poll(&self) -> Result<(), GpuError> {
        self.poll_until(wgpu::PollType::Poll)
    }

    fn poll_until(&self, until: wgpu::PollType) -> Result<(), GpuError> {
        let polled = self.poll_device(until);
        self.check()?;
        polled
    }

    fn poll_device(&self, until: wgpu::PollType) -> Result<(), GpuError> {
        // If the device is lost meanwhile, wgpu calls the callback and then panics.
        match catch_unwind(AssertUnwindSafe(|| self.0.device.poll(until))) {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(GpuError::Lost(error.to_string())),
            Err(_) => Err(GpuError::Lost("waiting for it failed".into())),
        }
    }
}
