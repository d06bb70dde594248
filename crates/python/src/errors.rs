//! From errors of the library to exceptions of Python, each with its one-line message.

use std::io::{self, ErrorKind};

use pyo3::PyErr;
use pyo3::exceptions::{
    PyFileExistsError, PyFileNotFoundError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyPermissionError,
    PyRuntimeError, PyValueError,
};
use tcgs_capture::CaptureError;
use tcgs_codec::DecodeError;
use tcgs_core::printable;
use tcgs_interchange::InterchangeError;
use tcgs_metrics::MetricsError;
use tcgs_pipeline::{Fault, HasFault, NewFolder, PipelineError};
use tcgs_prepare::PrepareError;
use tcgs_render::device::GpuError;
use tcgs_train::TrainError;

/// The exception for an error: `OSError` for an error of the system about a file, `ValueError` for other wrong input,
/// `MemoryError` for a GPU without enough memory, `RuntimeError` for any other fault of the machine.
pub fn exception(error: impl Into<PipelineError>) -> PyErr {
    let error = error.into();
    let lifted = if matches!(error, PipelineError::Interchange(InterchangeError::Limit { .. })) {
        "; no_limits=True lifts it"
    } else {
        ""
    };
    let message = format!("{}{lifted}", printable(&NewFolder::by_final_names(error.to_string())));
    if let PipelineError::Gpu(GpuError::Memory { .. })
    | PipelineError::Train(TrainError::Gpu(GpuError::Memory { .. })) = error
    {
        return PyMemoryError::new_err(message);
    }
    match &error {
        PipelineError::Exists { .. } => {
            return PyFileExistsError::new_err(format!("{message} or overwrite=True to replace it"));
        }
        PipelineError::NoMasks { .. } => return PyValueError::new_err(format!("{message}; or masks=False")),
        PipelineError::NoCalibration { .. } => {
            return PyValueError::new_err(format!("{message}; or calibration=FILE"));
        }
        _ => {}
    }
    match (cause(&error), error.fault()) {
        (Some(cause), _) if !matches!(cause.kind(), ErrorKind::InvalidData | ErrorKind::UnexpectedEof) => {
            of_system(cause.kind(), message)
        }
        (_, Fault::Input) => PyValueError::new_err(message),
        (_, Fault::Stopped) => PyKeyboardInterrupt::new_err(message),
        _ => PyRuntimeError::new_err(message),
    }
}

/// The exception of an answer of the system.
///
/// - `message`: names the file
pub fn of_system(kind: ErrorKind, message: String) -> PyErr {
    match kind {
        ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        ErrorKind::AlreadyExists => PyFileExistsError::new_err(message),
        ErrorKind::PermissionDenied => PyPermissionError::new_err(message),
        _ => PyOSError::new_err(message),
    }
}

/// The answer of the system that an error reports, if there is one.
fn cause(error: &PipelineError) -> Option<&io::Error> {
    match error {
        PipelineError::Unreadable { error, .. }
        | PipelineError::Unwritable { error, .. }
        | PipelineError::Capture(CaptureError::Io { error, .. })
        | PipelineError::Prepare(PrepareError::Io { error, .. })
        | PipelineError::Train(TrainError::Read { error, .. } | TrainError::Write { error, .. })
        | PipelineError::Interchange(InterchangeError::Read { error, .. } | InterchangeError::Write { error, .. })
        | PipelineError::Metrics(MetricsError::Io { error, .. })
        | PipelineError::Decode { error: DecodeError::Io(error), .. } => Some(error),
        _ => None,
    }
}
