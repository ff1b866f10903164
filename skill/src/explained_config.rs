//! Structs of configuration whose doc comments can be printed.
//!
//! [`explained_config`] makes of a struct with a default beside each field: the struct as serde reads
//! it, its `Default`, and the doc comments of its fields as text. So a value's default, its meaning in
//! the documentation and its meaning in `linkage config dump` are written once.

/// A field's name and its doc comment, a line of it in each line.
pub(crate) type Explanation = (&'static str, &'static str);

macro_rules! explained_config {
    (
        $(#[doc = $struct_doc:literal])+
        pub struct $name:ident {
            $( $(#[doc = $doc:literal])+ pub $field:ident: $type:ty = $default:expr, )+
        }
    ) => {
        $(#[doc = $struct_doc])+
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        #[non_exhaustive]
        pub struct $name {
            $( $(#[doc = $doc])+ pub $field: $type, )+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )+ }
            }
        }

        impl $name {
            /// The fields with their explanations.
            pub(crate) const EXPLANATIONS: &'static [$crate::explained_config::Explanation] =
                &[ $( (stringify!($field), concat!($( $doc, "\n" ),+)), )+ ];
        }
    };
}

pub(crate) use explained_config;
