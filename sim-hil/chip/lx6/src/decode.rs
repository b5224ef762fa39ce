//! Instructions: their bits as an operation with its fields (Xtensa ISA Reference Manual, section 7.3, "Opcode Maps").

/// What an instruction does. Names are the manual's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the manual's chapter 6 has a page for each")]
pub enum Operation {
    /// Not looked at yet.
    Unknown,
    /// None that this core knows; the immediate holds its bits.
    Illegal,
    Abs,
    Add,
    Addi,
    Addx2,
    Addx4,
    Addx8,
    And,
    Neg,
    Or,
    Sub,
    Subx2,
    Subx4,
    Subx8,
    Xor,
    Extui,
    Movi,
    Clamps,
    Max,
    Maxu,
    Min,
    Minu,
    Nsa,
    Nsau,
    Sext,
    Moveqz,
    Movnez,
    Movltz,
    Movgez,
    Movf,
    Movt,
    Slli,
    Srai,
    Srli,
    Src,
    Sll,
    Sra,
    Srl,
    Ssr,
    Ssl,
    Ssa8l,
    Ssa8b,
    Ssai,
    Mul16u,
    Mul16s,
    Mull,
    Muluh,
    Mulsh,
    Quou,
    Quos,
    Remu,
    Rems,
    L8ui,
    L16ui,
    L16si,
    L32i,
    L32r,
    S8i,
    S16i,
    S32i,
    S32c1i,
    L32e,
    S32e,
    J,
    Jx,
    Call0,
    Callx0,
    Ret,
    /// `call4`, `call8`, `call12`: the register number is how far the windows turn.
    Call,
    Callx,
    Entry,
    Retw,
    Movsp,
    Rotw,
    Rfwo,
    Rfwu,
    Beqz,
    Bnez,
    Bltz,
    Bgez,
    Beqi,
    Bnei,
    Blti,
    Bgei,
    Bltui,
    Bgeui,
    Ball,
    Bany,
    Bbc,
    Bbci,
    Bbs,
    Bbsi,
    Beq,
    Bge,
    Bgeu,
    Blt,
    Bltu,
    Bnall,
    Bne,
    Bnone,
    Bf,
    Bt,
    Loop,
    Loopnez,
    Loopgtz,
    Rsr,
    Wsr,
    Xsr,
    Rur,
    Wur,
    Rsil,
    Nop,
    /// Waits for memory or for special registers.
    Barrier,
    Simcall,
}

impl Operation {
    /// Returns whether it needs its registers `s` and `t`; a return needs `a0`, which is what its `s` is.
    const fn reads(self) -> (bool, bool) {
        use Operation as O;
        match self {
            O::Unknown
            | O::Illegal
            | O::Movi
            | O::Ssai
            | O::L32r
            | O::J
            | O::Call0
            | O::Call
            | O::Rotw
            | O::Rfwo
            | O::Rfwu
            | O::Bf
            | O::Bt
            | O::Rsr
            | O::Rur
            | O::Rsil
            | O::Nop
            | O::Barrier
            | O::Simcall => (false, false),
            O::Abs
            | O::Neg
            | O::Extui
            | O::Srai
            | O::Srli
            | O::Srl
            | O::Sra
            | O::Wsr
            | O::Xsr
            | O::Wur => (false, true),
            O::Addi
            | O::Slli
            | O::Sll
            | O::Sext
            | O::Clamps
            | O::Nsa
            | O::Nsau
            | O::Movf
            | O::Movt
            | O::Ssr
            | O::Ssl
            | O::Ssa8l
            | O::Ssa8b
            | O::L8ui
            | O::L16ui
            | O::L16si
            | O::L32i
            | O::L32e
            | O::Jx
            | O::Callx0
            | O::Callx
            | O::Ret
            | O::Retw
            | O::Entry
            | O::Movsp
            | O::Beqz
            | O::Bnez
            | O::Bltz
            | O::Bgez
            | O::Beqi
            | O::Bnei
            | O::Blti
            | O::Bgei
            | O::Bltui
            | O::Bgeui
            | O::Bbci
            | O::Bbsi
            | O::Loop
            | O::Loopnez
            | O::Loopgtz => (true, false),
            _ => (true, true),
        }
    }
}

/// An instruction ready to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instruction {
    /// What it does.
    pub operation: Operation,
    /// Registers: mostly the destination, and two sources. Those that it does not use are 0.
    pub r: u8,
    /// See `r`.
    pub s: u8,
    /// See `r`.
    pub t: u8,
    /// Bytes that it takes.
    pub length: u8,
    /// How many groups of four registers beyond the first it reaches: 0 to 3.
    pub reach: u8,
    /// Whether it needs the register `s`.
    pub reads_s: bool,
    /// Whether it needs the register `t`.
    pub reads_t: bool,
    /// A constant, the distance from the instruction to its target, or the number of a special register.
    pub immediate: i32,
}

const _: () = assert!(size_of::<Instruction>() <= 12);

impl Instruction {
    /// Not decoded yet.
    pub const UNKNOWN: Self = Self {
        operation: Operation::Unknown,
        r: 0,
        s: 0,
        t: 0,
        length: 0,
        reach: 0,
        reads_s: false,
        reads_t: false,
        immediate: 0,
    };
}

/// Constants of the branches that compare with one, signed (table 3-17).
const SIGNED: [i32; 16] = [-1, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 32, 64, 128, 256];
/// The same, unsigned (table 3-18).
const UNSIGNED: [i32; 16] = [32768, 65536, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 32, 64, 128, 256];

const fn bits(word: u32, low: u32, count: u32) -> u32 {
    word >> low & ((1 << count) - 1)
}

const fn signed(value: u32, bits: u32) -> i32 {
    (value << (32 - bits)).cast_signed() >> (32 - bits)
}

/// The fields that instructions of every format are made of.
struct Fields {
    word: u32,
    r: u8,
    s: u8,
    t: u8,
    narrow: bool,
}

/// Decodes the instruction that these bits begin with, the first byte lowest. Branches hold the distance from the instruction
/// itself; `l32r` the one from the word that the instruction's end lies in.
#[must_use]
pub fn decode(word: u32) -> Instruction {
    let field = |low| bits(word, low, 4) as u8;
    let fields = Fields {
        word,
        t: field(4),
        s: field(8),
        r: field(12),
        narrow: word & 8 != 0 && word & 15 != 15,
    };
    match word & 15 {
        0 => fields.qrst(),
        1 => fields.to_t(Operation::L32r, (0xffff_0000 | bits(word, 8, 16)).cast_signed() << 2),
        2 => fields.lsai(),
        5 => fields.call(),
        6 => fields.si(),
        7 => fields.compare(),
        8 => fields.base(Operation::L32i, u32::from(fields.r) << 2),
        9 => fields.base(Operation::S32i, u32::from(fields.r) << 2),
        10 => fields.rst(Operation::Add),
        11 => fields.make(
            Operation::Addi,
            fields.r,
            fields.s,
            0,
            if fields.t == 0 { -1 } else { i32::from(fields.t) },
        ),
        12 => fields.st2(),
        13 => fields.st3(),
        _ => fields.illegal(),
    }
}

impl Fields {
    fn make(&self, operation: Operation, r: u8, s: u8, t: u8, immediate: i32) -> Instruction {
        let turn = match operation {
            Operation::Call | Operation::Callx => r,
            _ => 0,
        };
        let reach = (r.max(s).max(t) >> 2).max(turn);
        let length = if self.narrow { 2 } else { 3 };
        let (reads_s, reads_t) = operation.reads();
        Instruction { operation, r, s, t, length, reach, reads_s, reads_t, immediate }
    }

    fn illegal(&self) -> Instruction {
        let word = if self.narrow { self.word & 0xffff } else { self.word & 0xff_ffff };
        self.make(Operation::Illegal, 0, 0, 0, word.cast_signed())
    }

    fn rst(&self, operation: Operation) -> Instruction {
        self.make(operation, self.r, self.s, self.t, 0)
    }

    /// From s to r with a constant.
    fn rs(&self, operation: Operation, immediate: u32) -> Instruction {
        self.make(operation, self.r, self.s, 0, immediate.cast_signed())
    }

    /// From t to r with a constant.
    fn rt(&self, operation: Operation, immediate: u32) -> Instruction {
        self.make(operation, self.r, 0, self.t, immediate.cast_signed())
    }

    fn to_t(&self, operation: Operation, immediate: i32) -> Instruction {
        self.make(operation, 0, 0, self.t, immediate)
    }

    fn of_s(&self, operation: Operation, immediate: i32) -> Instruction {
        self.make(operation, 0, self.s, 0, immediate)
    }

    /// Memory at s and a constant, from or to t.
    fn base(&self, operation: Operation, immediate: u32) -> Instruction {
        self.make(operation, 0, self.s, self.t, immediate.cast_signed())
    }

    fn plain(&self, operation: Operation) -> Instruction {
        self.make(operation, 0, 0, 0, 0)
    }

    fn qrst(&self) -> Instruction {
        let (op1, op2) = (bits(self.word, 16, 4), bits(self.word, 20, 4));
        match op1 {
            0 => self.rst0(op2),
            1 => self.rst1(op2),
            2 => self.rst2(op2),
            3 => self.rst3(op2),
            4 | 5 => {
                // How far to shift in the lower five bits, how many bits to keep above.
                let shift = (op1 & 1) << 4 | u32::from(self.s);
                self.rt(Operation::Extui, (op2 + 1) << 5 | shift)
            }
            9 => {
                let distance = (i32::from(self.r) - 16) * 4;
                match op2 {
                    0 => self.base(Operation::L32e, distance.cast_unsigned()),
                    4 => self.base(Operation::S32e, distance.cast_unsigned()),
                    _ => self.illegal(),
                }
            }
            _ => self.illegal(),
        }
    }

    fn rst0(&self, op2: u32) -> Instruction {
        use Operation as O;
        match op2 {
            0 => self.st0(),
            1 => self.rst(O::And),
            2 => self.rst(O::Or),
            3 => self.rst(O::Xor),
            4 => self.st1(),
            6 if self.s == 0 => self.rt(O::Neg, 0),
            6 if self.s == 1 => self.rt(O::Abs, 0),
            8 => self.rst(O::Add),
            9 => self.rst(O::Addx2),
            10 => self.rst(O::Addx4),
            11 => self.rst(O::Addx8),
            12 => self.rst(O::Sub),
            13 => self.rst(O::Subx2),
            14 => self.rst(O::Subx4),
            15 => self.rst(O::Subx8),
            _ => self.illegal(),
        }
    }

    fn st0(&self) -> Instruction {
        use Operation as O;
        match (self.r, self.s, self.t) {
            (0, 0, 8) => self.plain(O::Ret),
            (0, 0, 9) => self.plain(O::Retw),
            (0, _, 10) => self.of_s(O::Jx, 0),
            (0, _, 12) => self.of_s(O::Callx0, 0),
            (0, _, 13..=15) => self.make(O::Callx, self.t & 3, self.s, 0, 0),
            (1, ..) => self.base(O::Movsp, 0),
            (2, 0, 0..=3 | 8 | 12 | 13) => self.plain(O::Barrier),
            (2, 0, 15) => self.plain(O::Nop),
            (3, 4, 0) => self.plain(O::Rfwo),
            (3, 5, 0) => self.plain(O::Rfwu),
            (5, 1, 0) => self.plain(O::Simcall),
            (6, level, _) => self.to_t(O::Rsil, i32::from(level)),
            _ => self.illegal(),
        }
    }

    fn st1(&self) -> Instruction {
        use Operation as O;
        match self.r {
            0 => self.of_s(O::Ssr, 0),
            1 => self.of_s(O::Ssl, 0),
            2 => self.of_s(O::Ssa8l, 0),
            3 => self.of_s(O::Ssa8b, 0),
            4 => self.make(O::Ssai, 0, 0, 0, i32::from(self.t & 1) << 4 | i32::from(self.s)),
            8 if self.s == 0 => self.make(O::Rotw, 0, 0, 0, signed(u32::from(self.t), 4)),
            14 => self.base(O::Nsa, 0),
            15 => self.base(O::Nsau, 0),
            _ => self.illegal(),
        }
    }

    fn rst1(&self, op2: u32) -> Instruction {
        use Operation as O;
        let high = (op2 & 1) << 4;
        match op2 {
            0 | 1 => self.rs(O::Slli, 32 - (high | u32::from(self.t))),
            2 | 3 => self.rt(O::Srai, high | u32::from(self.s)),
            4 => self.rt(O::Srli, u32::from(self.s)),
            6 => self.special(O::Xsr),
            8 => self.rst(O::Src),
            9 if self.s == 0 => self.rt(O::Srl, 0),
            10 if self.t == 0 => self.rs(O::Sll, 0),
            11 if self.s == 0 => self.rt(O::Sra, 0),
            12 => self.rst(O::Mul16u),
            13 => self.rst(O::Mul16s),
            _ => self.illegal(),
        }
    }

    fn rst2(&self, op2: u32) -> Instruction {
        use Operation as O;
        match op2 {
            8 => self.rst(O::Mull),
            10 => self.rst(O::Muluh),
            11 => self.rst(O::Mulsh),
            12 => self.rst(O::Quou),
            13 => self.rst(O::Quos),
            14 => self.rst(O::Remu),
            15 => self.rst(O::Rems),
            _ => self.illegal(),
        }
    }

    fn rst3(&self, op2: u32) -> Instruction {
        use Operation as O;
        match op2 {
            0 => self.special(O::Rsr),
            1 => self.special(O::Wsr),
            2 => self.rs(O::Sext, u32::from(self.t) + 7),
            3 => self.rs(O::Clamps, u32::from(self.t) + 7),
            4 => self.rst(O::Min),
            5 => self.rst(O::Max),
            6 => self.rst(O::Minu),
            7 => self.rst(O::Maxu),
            8 => self.rst(O::Moveqz),
            9 => self.rst(O::Movnez),
            10 => self.rst(O::Movltz),
            11 => self.rst(O::Movgez),
            // The boolean's number in place of a register's.
            12 => self.rs(O::Movf, u32::from(self.t)),
            13 => self.rs(O::Movt, u32::from(self.t)),
            14 => self.make(O::Rur, self.r, 0, 0, i32::from(self.s) << 4 | i32::from(self.t)),
            15 => self.to_t(O::Wur, bits(self.word, 8, 8).cast_signed()),
            _ => self.illegal(),
        }
    }

    fn special(&self, operation: Operation) -> Instruction {
        self.to_t(operation, bits(self.word, 8, 8).cast_signed())
    }

    fn lsai(&self) -> Instruction {
        use Operation as O;
        let byte = bits(self.word, 16, 8);
        match self.r {
            0 => self.base(O::L8ui, byte),
            1 => self.base(O::L16ui, byte << 1),
            2 | 11 => self.base(O::L32i, byte << 2),
            4 => self.base(O::S8i, byte),
            5 => self.base(O::S16i, byte << 1),
            6 | 15 => self.base(O::S32i, byte << 2),
            9 => self.base(O::L16si, byte << 1),
            10 => self.to_t(O::Movi, signed(u32::from(self.s) << 8 | byte, 12)),
            12 => self.make(O::Addi, self.t, self.s, 0, signed(byte, 8)),
            13 => self.make(O::Addi, self.t, self.s, 0, signed(byte, 8) << 8),
            14 => self.base(O::S32c1i, byte << 2),
            _ => self.illegal(),
        }
    }

    fn call(&self) -> Instruction {
        let distance = (signed(bits(self.word, 6, 18), 18) << 2) + 4;
        match self.t & 3 {
            0 => self.make(Operation::Call0, 0, 0, 0, distance),
            turn => self.make(Operation::Call, turn, 0, 0, distance),
        }
    }

    fn si(&self) -> Instruction {
        use Operation as O;
        let (n, m) = (self.t & 3, self.t >> 2);
        let byte = signed(bits(self.word, 16, 8), 8) + 4;
        // The constant is a table's; its index stands where a register's number does.
        let compare = |operation| Instruction { t: self.r, ..self.of_s(operation, byte) };
        let from_zero = |operation| self.of_s(operation, signed(bits(self.word, 12, 12), 12) + 4);
        match (n, m, self.r) {
            (0, ..) => self.make(O::J, 0, 0, 0, signed(bits(self.word, 6, 18), 18) + 4),
            (1, 0, _) => from_zero(O::Beqz),
            (1, 1, _) => from_zero(O::Bnez),
            (1, 2, _) => from_zero(O::Bltz),
            (1, 3, _) => from_zero(O::Bgez),
            (2, 0, _) => compare(O::Beqi),
            (2, 1, _) => compare(O::Bnei),
            (2, 2, _) => compare(O::Blti),
            (2, 3, _) => compare(O::Bgei),
            (3, 0, _) => self.of_s(O::Entry, bits(self.word, 12, 12).cast_signed() << 3),
            (3, 1, 0) => Instruction { t: self.s, ..self.make(O::Bf, 0, 0, 0, byte) },
            (3, 1, 1) => Instruction { t: self.s, ..self.make(O::Bt, 0, 0, 0, byte) },
            (3, 1, 8) => self.of_s(O::Loop, bits(self.word, 16, 8).cast_signed() + 4),
            (3, 1, 9) => self.of_s(O::Loopnez, bits(self.word, 16, 8).cast_signed() + 4),
            (3, 1, 10) => self.of_s(O::Loopgtz, bits(self.word, 16, 8).cast_signed() + 4),
            (3, 2, _) => compare(O::Bltui),
            (3, 3, _) => compare(O::Bgeui),
            _ => self.illegal(),
        }
    }

    fn compare(&self) -> Instruction {
        use Operation as O;
        let distance = signed(bits(self.word, 16, 8), 8) + 4;
        let registers = |operation| self.make(operation, 0, self.s, self.t, distance);
        // The bit's number stands where a register's does.
        let bit = |operation| Instruction {
            t: (self.r & 1) << 4 | self.t,
            ..self.of_s(operation, distance)
        };
        match self.r {
            0 => registers(O::Bnone),
            1 => registers(O::Beq),
            2 => registers(O::Blt),
            3 => registers(O::Bltu),
            4 => registers(O::Ball),
            5 => registers(O::Bbc),
            6 | 7 => bit(O::Bbci),
            8 => registers(O::Bany),
            9 => registers(O::Bne),
            10 => registers(O::Bge),
            11 => registers(O::Bgeu),
            12 => registers(O::Bnall),
            13 => registers(O::Bbs),
            _ => bit(O::Bbsi),
        }
    }

    fn st2(&self) -> Instruction {
        let (r, t) = (u32::from(self.r), u32::from(self.t));
        let forwards = i32::from(self.t & 3) << 4 | i32::from(self.r);
        match t >> 2 {
            2 => self.of_s(Operation::Beqz, forwards + 4),
            3 => self.of_s(Operation::Bnez, forwards + 4),
            _ => {
                let value = (t & 7) << 4 | r;
                // From -32 to 95.
                let value =
                    if value >= 96 { value.cast_signed() - 128 } else { value.cast_signed() };
                self.make(Operation::Movi, 0, 0, self.s, value)
            }
        }
    }

    fn st3(&self) -> Instruction {
        use Operation as O;
        match (self.r, self.s, self.t) {
            // As `or` of one register twice.
            (0, ..) => self.make(O::Or, self.t, self.s, self.s, 0),
            (15, 0, 0) => self.plain(O::Ret),
            (15, 0, 1) => self.plain(O::Retw),
            (15, 0, 3) => self.plain(O::Nop),
            _ => self.illegal(),
        }
    }
}

/// Returns the constant that an instruction of the branches with one compares with, from its index.
#[must_use]
pub fn constant(index: u8) -> i32 {
    SIGNED[usize::from(index & 15)]
}

/// Returns the same of the unsigned branches.
#[must_use]
pub fn unsigned_constant(index: u8) -> u32 {
    UNSIGNED[usize::from(index & 15)].cast_unsigned()
}
