//! What ends an emulation: the image did something that the chip would not do, or that no model knows.

/// What was wrong. Each is an error in the image or a gap in the emulator, never passed over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Trouble {
    /// A register of a known block, of which no model knows what it does.
    #[error("{access} of {register} ({address:#010x}), which is not modelled")]
    NotModelled {
        /// "read" or "write".
        access: &'static str,
        /// Block and name.
        register: String,
        /// Its address.
        address: u32,
    },
    /// A register is given a value whose effect is not modelled.
    #[error("{register} is set to {value:#x}: {reason}")]
    Value {
        /// Block and name.
        register: String,
        /// What was written.
        value: u32,
        /// Why this cannot be emulated, or would not work on the chip.
        reason: &'static str,
    },
    /// No register is known there.
    #[error("{access} of {address:#010x}, where no register is known")]
    NoRegister {
        /// "read" or "write".
        access: &'static str,
        /// Where.
        address: u32,
    },
    /// A function of the mask ROM that is not known.
    #[error("call of {0} in the mask ROM, which is not modelled")]
    Rom(String),
    /// A function of the radio library that reaches its border in an unexpected way.
    #[error("radio: {0}")]
    Radio(String),
    /// An exception before the image could handle any, or within its handler.
    #[error("exception {cause} (value {value:#010x}) without a handler")]
    Exception {
        /// As in `mcause`.
        cause: u32,
        /// As in `mtval`.
        value: u32,
    },
}

/// What was wrong, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{trouble}, at {pc:#010x}")]
pub struct Fault {
    /// What.
    pub trouble: Trouble,
    /// Program counter.
    pub pc: u32,
}
