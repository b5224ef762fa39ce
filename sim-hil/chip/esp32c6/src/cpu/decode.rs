//! RV32IMAC instructions (RISC-V unprivileged specification 20191213), decoded once and kept.

/// What an instruction does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Kind {
    /// Not looked at yet.
    Unknown,
    /// No instruction of this processor; the immediate holds its bits.
    Illegal,
    Lui,
    Auipc,
    Jal,
    Jalr,
    Beq,
    Bne,
    Blt,
    Bge,
    Bltu,
    Bgeu,
    Lb,
    Lh,
    Lw,
    Lbu,
    Lhu,
    Sb,
    Sh,
    Sw,
    Addi,
    Slti,
    Sltiu,
    Xori,
    Ori,
    Andi,
    Slli,
    Srli,
    Srai,
    Add,
    Sub,
    Sll,
    Slt,
    Sltu,
    Xor,
    Srl,
    Sra,
    Or,
    And,
    Mul,
    Mulh,
    Mulhsu,
    Mulhu,
    Div,
    Divu,
    Rem,
    Remu,
    Fence,
    LoadReserved,
    StoreConditional,
    AmoAdd,
    AmoSwap,
    AmoXor,
    AmoOr,
    AmoAnd,
    AmoMin,
    AmoMax,
    AmoMinu,
    AmoMaxu,
    /// The immediate is the register's number; `rs2` the kind of access (funct3).
    Csr,
    Ecall,
    Ebreak,
    Mret,
    Wfi,
    /// A function that is done outside the processor; the immediate is its number.
    Host,
}

/// Where results for `x0` go: beside the registers that are read.
pub(crate) const DISCARDED: u8 = 32;
/// Marks a compressed instruction in [`Instruction::length`].
const COMPRESSED: u8 = 2;

/// An instruction ready to run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Instruction {
    pub(crate) kind: Kind,
    /// Destination; [`DISCARDED`] for `x0`.
    pub(crate) rd: u8,
    pub(crate) rs1: u8,
    /// Second source, and in the upper three bits the length in bytes.
    rs2_and_length: u8,
    pub(crate) immediate: i32,
}

impl Instruction {
    /// Not decoded yet.
    pub(crate) const UNKNOWN: Self =
        Self { kind: Kind::Unknown, rd: 0, rs1: 0, rs2_and_length: 0, immediate: 0 };

    /// Stands for a function that is done outside the processor.
    pub(crate) const fn host(number: i32) -> Self {
        Self { kind: Kind::Host, immediate: number, ..Self::UNKNOWN }
    }

    /// Returns the second source register.
    pub(crate) const fn rs2(self) -> u8 {
        self.rs2_and_length & 31
    }

    /// Bytes that it takes.
    pub(crate) const fn length(self) -> u32 {
        (self.rs2_and_length >> 5) as u32
    }

    /// Decodes the instruction whose bits start in the low half of `raw`.
    pub(crate) fn decode(raw: u32) -> Self {
        let is_compressed = raw & 3 != 3;
        let code = if is_compressed { expand(raw & 0xFFFF) } else { raw };
        let mut instruction = decode_full(code);
        if instruction.kind == Kind::Illegal {
            instruction.immediate = if is_compressed { raw & 0xFFFF } else { raw } as i32;
        }
        let length = if is_compressed { COMPRESSED } else { 4 };
        instruction.rs2_and_length |= length << 5;
        instruction
    }
}

const fn bits(value: u32, low: u32, count: u32) -> u32 {
    value >> low & ((1 << count) - 1)
}

const fn sign_extended(value: u32, bits: u32) -> i32 {
    ((value << (32 - bits)) as i32) >> (32 - bits)
}

fn decode_full(code: u32) -> Instruction {
    let (rd, rs1, rs2) = (bits(code, 7, 5) as u8, bits(code, 15, 5) as u8, bits(code, 20, 5) as u8);
    let (funct3, funct7) = (bits(code, 12, 3), code >> 25);
    let immediate_i = code as i32 >> 20;
    let make = |kind, immediate| Instruction {
        kind,
        rd: if rd == 0 { DISCARDED } else { rd },
        rs1,
        rs2_and_length: rs2,
        immediate,
    };
    let illegal = make(Kind::Illegal, 0);
    match code & 0x7F {
        0x37 => make(Kind::Lui, (code & 0xFFFF_F000) as i32),
        0x17 => make(Kind::Auipc, (code & 0xFFFF_F000) as i32),
        0x6F => {
            let offset = bits(code, 31, 1) << 20
                | bits(code, 12, 8) << 12
                | bits(code, 20, 1) << 11
                | bits(code, 21, 10) << 1;
            make(Kind::Jal, sign_extended(offset, 21))
        }
        0x67 if funct3 == 0 => make(Kind::Jalr, immediate_i),
        0x63 => {
            let kind = match funct3 {
                0 => Kind::Beq,
                1 => Kind::Bne,
                4 => Kind::Blt,
                5 => Kind::Bge,
                6 => Kind::Bltu,
                7 => Kind::Bgeu,
                _ => return illegal,
            };
            let offset = bits(code, 31, 1) << 12
                | bits(code, 7, 1) << 11
                | bits(code, 25, 6) << 5
                | bits(code, 8, 4) << 1;
            make(kind, sign_extended(offset, 13))
        }
        0x03 => match funct3 {
            0 => make(Kind::Lb, immediate_i),
            1 => make(Kind::Lh, immediate_i),
            2 => make(Kind::Lw, immediate_i),
            4 => make(Kind::Lbu, immediate_i),
            5 => make(Kind::Lhu, immediate_i),
            _ => illegal,
        },
        0x23 => {
            let immediate = sign_extended(funct7 << 5 | u32::from(rd), 12);
            match funct3 {
                0 => make(Kind::Sb, immediate),
                1 => make(Kind::Sh, immediate),
                2 => make(Kind::Sw, immediate),
                _ => illegal,
            }
        }
        0x13 => match (funct3, funct7) {
            (0, _) => make(Kind::Addi, immediate_i),
            (2, _) => make(Kind::Slti, immediate_i),
            (3, _) => make(Kind::Sltiu, immediate_i),
            (4, _) => make(Kind::Xori, immediate_i),
            (6, _) => make(Kind::Ori, immediate_i),
            (7, _) => make(Kind::Andi, immediate_i),
            (1, 0) => make(Kind::Slli, i32::from(rs2)),
            (5, 0) => make(Kind::Srli, i32::from(rs2)),
            (5, 0x20) => make(Kind::Srai, i32::from(rs2)),
            _ => illegal,
        },
        0x33 => match (funct7, funct3) {
            (0, 0) => make(Kind::Add, 0),
            (0x20, 0) => make(Kind::Sub, 0),
            (0, 1) => make(Kind::Sll, 0),
            (0, 2) => make(Kind::Slt, 0),
            (0, 3) => make(Kind::Sltu, 0),
            (0, 4) => make(Kind::Xor, 0),
            (0, 5) => make(Kind::Srl, 0),
            (0x20, 5) => make(Kind::Sra, 0),
            (0, 6) => make(Kind::Or, 0),
            (0, 7) => make(Kind::And, 0),
            (1, 0) => make(Kind::Mul, 0),
            (1, 1) => make(Kind::Mulh, 0),
            (1, 2) => make(Kind::Mulhsu, 0),
            (1, 3) => make(Kind::Mulhu, 0),
            (1, 4) => make(Kind::Div, 0),
            (1, 5) => make(Kind::Divu, 0),
            (1, 6) => make(Kind::Rem, 0),
            (1, 7) => make(Kind::Remu, 0),
            _ => illegal,
        },
        0x0F => make(Kind::Fence, 0),
        0x2F if funct3 == 2 => match funct7 >> 2 {
            0 => make(Kind::AmoAdd, 0),
            1 => make(Kind::AmoSwap, 0),
            2 if rs2 == 0 => make(Kind::LoadReserved, 0),
            3 => make(Kind::StoreConditional, 0),
            4 => make(Kind::AmoXor, 0),
            8 => make(Kind::AmoOr, 0),
            12 => make(Kind::AmoAnd, 0),
            16 => make(Kind::AmoMin, 0),
            20 => make(Kind::AmoMax, 0),
            24 => make(Kind::AmoMinu, 0),
            28 => make(Kind::AmoMaxu, 0),
            _ => illegal,
        },
        0x73 => match (funct3, code) {
            (0, 0x0000_0073) => make(Kind::Ecall, 0),
            (0, 0x0010_0073) => make(Kind::Ebreak, 0),
            (0, 0x3020_0073) => make(Kind::Mret, 0),
            (0, 0x1050_0073) => make(Kind::Wfi, 0),
            (0 | 4, _) => illegal,
            _ => {
                Instruction { rs2_and_length: funct3 as u8, ..make(Kind::Csr, (code >> 20) as i32) }
            }
        },
        _ => illegal,
    }
}

/// The instruction that a compressed one stands for; 0, which is illegal, where there is none.
fn expand(code: u32) -> u32 {
    let field = |low, count| bits(code, low, count);
    let (rd, rs2) = (field(7, 5), field(2, 5));
    let (low_rd, low_rs1, low_rs2) = (field(2, 3) + 8, field(7, 3) + 8, field(2, 3) + 8);
    let immediate_6 = sign_extended(field(12, 1) << 5 | field(2, 5), 6) as u32;
    match (code & 3, field(13, 3)) {
        (0, 0) => {
            let immediate =
                field(7, 4) << 6 | field(11, 2) << 4 | field(5, 1) << 3 | field(6, 1) << 2;
            if immediate == 0 { 0 } else { form_i(immediate, 2, 0, low_rd, 0x13) }
        }
        (0, 2) => form_i(word_offset(code), low_rs1, 2, low_rd, 0x03),
        (0, 6) => form_s(word_offset(code), low_rs2, low_rs1, 2),
        (1, 0) => form_i(immediate_6, rd, 0, rd, 0x13),
        (1, 1) => form_j(jump_offset(code), 1),
        (1, 2) => form_i(immediate_6, 0, 0, rd, 0x13),
        (1, 3) if rd == 2 => {
            let immediate = field(12, 1) << 9
                | field(3, 2) << 7
                | field(5, 1) << 6
                | field(2, 1) << 5
                | field(6, 1) << 4;
            if immediate == 0 {
                return 0;
            }
            form_i(sign_extended(immediate, 10) as u32, 2, 0, 2, 0x13)
        }
        (1, 3) if immediate_6 == 0 => 0,
        (1, 3) => immediate_6 << 12 | rd << 7 | 0x37,
        (1, 4) => match (field(10, 2), field(12, 1), field(5, 2)) {
            // A shift by 32 and more is reserved on 32 bits.
            (0, 0, _) => form_i(field(2, 5), low_rs1, 5, low_rs1, 0x13),
            (1, 0, _) => form_i(0x400 | field(2, 5), low_rs1, 5, low_rs1, 0x13),
            (2, _, _) => form_i(immediate_6, low_rs1, 7, low_rs1, 0x13),
            (3, 0, 0) => form_r(0x20, low_rs2, low_rs1, 0, low_rs1),
            (3, 0, 1) => form_r(0, low_rs2, low_rs1, 4, low_rs1),
            (3, 0, 2) => form_r(0, low_rs2, low_rs1, 6, low_rs1),
            (3, 0, 3) => form_r(0, low_rs2, low_rs1, 7, low_rs1),
            _ => 0,
        },
        (1, 5) => form_j(jump_offset(code), 0),
        (1, 6) => form_b(branch_offset(code), low_rs1, 0),
        (1, 7) => form_b(branch_offset(code), low_rs1, 1),
        (2, 0) if field(12, 1) == 0 => form_i(field(2, 5), rd, 1, rd, 0x13),
        (2, 2) if rd != 0 => {
            form_i(field(2, 2) << 6 | field(12, 1) << 5 | field(4, 3) << 2, 2, 2, rd, 0x03)
        }
        (2, 4) => match (field(12, 1), rd, rs2) {
            (0, 0, 0) => 0,
            (0, rs1, 0) => form_i(0, rs1, 0, 0, 0x67),
            (0, rd, rs2) => form_r(0, rs2, 0, 0, rd),
            (1, 0, 0) => 0x0010_0073,
            (1, rs1, 0) => form_i(0, rs1, 0, 1, 0x67),
            (_, rd, rs2) => form_r(0, rs2, rd, 0, rd),
        },
        (2, 6) => form_s(field(7, 2) << 6 | field(9, 4) << 2, rs2, 2, 2),
        _ => 0,
    }
}

const fn form_i(immediate: u32, rs1: u32, funct3: u32, rd: u32, opcode: u32) -> u32 {
    immediate << 20 | rs1 << 15 | funct3 << 12 | rd << 7 | opcode
}

const fn form_r(funct7: u32, rs2: u32, rs1: u32, funct3: u32, rd: u32) -> u32 {
    funct7 << 25 | rs2 << 20 | rs1 << 15 | funct3 << 12 | rd << 7 | 0x33
}

const fn form_s(immediate: u32, rs2: u32, rs1: u32, funct3: u32) -> u32 {
    bits(immediate, 5, 7) << 25
        | rs2 << 20
        | rs1 << 15
        | funct3 << 12
        | bits(immediate, 0, 5) << 7
        | 0x23
}

const fn form_b(offset: u32, rs1: u32, funct3: u32) -> u32 {
    bits(offset, 12, 1) << 31
        | bits(offset, 5, 6) << 25
        | rs1 << 15
        | funct3 << 12
        | bits(offset, 1, 4) << 8
        | bits(offset, 11, 1) << 7
        | 0x63
}

const fn form_j(offset: u32, rd: u32) -> u32 {
    bits(offset, 20, 1) << 31
        | bits(offset, 1, 10) << 21
        | bits(offset, 11, 1) << 20
        | bits(offset, 12, 8) << 12
        | rd << 7
        | 0x6F
}

const fn word_offset(code: u32) -> u32 {
    bits(code, 5, 1) << 6 | bits(code, 10, 3) << 3 | bits(code, 6, 1) << 2
}

const fn jump_offset(code: u32) -> u32 {
    let offset = bits(code, 12, 1) << 11
        | bits(code, 8, 1) << 10
        | bits(code, 9, 2) << 8
        | bits(code, 6, 1) << 7
        | bits(code, 7, 1) << 6
        | bits(code, 2, 1) << 5
        | bits(code, 11, 1) << 4
        | bits(code, 3, 3) << 1;
    sign_extended(offset, 12) as u32
}

const fn branch_offset(code: u32) -> u32 {
    let offset = bits(code, 12, 1) << 8
        | bits(code, 5, 2) << 6
        | bits(code, 2, 1) << 5
        | bits(code, 10, 2) << 3
        | bits(code, 3, 2) << 1;
    sign_extended(offset, 9) as u32
}
