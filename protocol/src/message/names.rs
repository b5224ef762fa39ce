//! One table of names for each enum that people read.

/// Gives an enum without fields its list of all variants and its words for people.
macro_rules! names {
    ($enum:ident { $($variant:ident: $name:literal),* $(,)? }) => {
        impl $enum {
            /// All variants, in order.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$variant),*];
        }

        impl core::fmt::Display for $enum {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(match self {
                    $(Self::$variant => $name,)*
                })
            }
        }
    };
}

pub(super) use names;
