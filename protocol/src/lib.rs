#![no_std]
#![forbid(unsafe_code)]
//! Units, messages, frames and authenticated sessions between a Flix-Walker and its operator
