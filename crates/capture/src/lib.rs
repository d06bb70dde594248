//! Multi-view captures: loading, checking and synthesising them
