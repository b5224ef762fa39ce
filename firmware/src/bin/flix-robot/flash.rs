//! The settings' partition in flash.
