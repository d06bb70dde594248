//! Status codes of the functions, and the text of a thread's last error.

use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};

use tcgs_codec::DecodeError;

/// Result of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Success.
    Ok = 0,
    /// An argument is wrong: NULL, a timestep that does not exist, arrays too short.
    Argument = 1,
    /// The file cannot be read. Trying again may help.
    Io = 2,
    /// The file is damaged, or is not a .tcgs file.
    Format = 3,
    /// The file has a version that this library does not know. A newer library may read it.
    Version = 4,
    /// The file asks for more memory than a scene of its length could need.
    Limit = 5,
    /// A defect of this library. Please report it.
    Defect = 6,
}

/// Why a call failed.
pub struct Failure {
    status: Status,
    text: String,
}

impl Failure {
    pub fn new(status: Status, text: String) -> Self {
        Self { status, text }
    }

    pub fn argument(name: &str, found: impl Display, expected: impl Display) -> Self {
        Self::new(Status::Argument, format!("{name}: found {found}, expected {expected}"))
    }
}

impl From<DecodeError> for Failure {
    fn from(error: DecodeError) -> Self {
        let (status, text) = match &error {
            DecodeError::Io(source) => (Status::Io, format!("{error}: {source}")),
            DecodeError::Version { .. } => (Status::Version, error.to_string()),
            DecodeError::Limit { .. } => (Status::Limit, error.to_string()),
            _ => (Status::Format, error.to_string()),
        };
        Self::new(status, text)
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::new(CString::default());
}

pub fn last_error() -> *const c_char {
    LAST.with_borrow(|text| text.as_ptr())
}

/// Runs the body of a function, and keeps the reason of a failure.
pub fn guarded(call: impl FnOnce() -> Result<(), Failure>) -> Status {
    let failure = match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(())) => return Status::Ok,
        Ok(Err(failure)) => failure,
        Err(_) => Failure::new(Status::Defect, "a defect of the library; please report it with the file".into()),
    };
    let text: Vec<u8> = failure.text.bytes().filter(|&byte| byte != 0).collect();
    LAST.set(CString::new(text).unwrap_or_default());
    failure.status
}
