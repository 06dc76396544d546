//! The methods that the server serves, as the descriptors of their services define them.

use std::sync::LazyLock;

use prost::Message;
use prost_types::FileDescriptorSet;

use crate::proto;

/// A method of a service.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Method {
    /// The name in metrics and logs: the path without its leading slash.
    pub(super) name: String,
    service: Service,
    /// Whether the request is a stream of messages.
    streams_requests: bool,
    /// Whether the answer is a stream of messages.
    streams_answers: bool,
}

/// The purpose of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Service {
    /// A service of the contract in `proto/`.
    Contract,
    Health,
    Reflection,
}

static METHODS: LazyLock<Vec<Method>> = LazyLock::new(|| {
    let served = [
        (Service::Contract, proto::FILE_DESCRIPTOR_SET),
        (Service::Health, tonic_health::pb::FILE_DESCRIPTOR_SET),
        (Service::Reflection, tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET),
        (Service::Reflection, tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET),
    ];
    served.into_iter().flat_map(|(service, descriptors)| methods(service, descriptors)).collect()
});

/// Stands for every method that the server does not have. Clients can send arbitrary paths, so metrics and logs
/// use one name for all unknown ones.
static OTHER: LazyLock<Method> = LazyLock::new(|| Method {
    name: "other".into(),
    service: Service::Contract,
    streams_requests: false,
    streams_answers: false,
});

/// The methods of the services in a set of descriptors. A set that cannot be read would have none; a test reads
/// each set that the server uses.
fn methods(service: Service, descriptors: &[u8]) -> Vec<Method> {
    let files = FileDescriptorSet::decode(descriptors).unwrap_or_default().file;
    let services = files.iter().flat_map(|file| file.service.iter().map(move |one| (file.package(), one)));
    let methods = services.flat_map(|(package, one)| {
        one.method.iter().map(move |method| Method {
            name: format!("{package}.{}/{}", one.name(), method.name()),
            service,
            streams_requests: method.client_streaming(),
            streams_answers: method.server_streaming(),
        })
    });
    methods.collect()
}

impl Method {
    /// The method with this path, or [`Method::other`] if the server does not have it.
    pub(super) fn of(path: &str) -> &'static Self {
        let name = path.strip_prefix('/');
        let known = METHODS.iter().find(|method| name == Some(method.name.as_str()));
        known.unwrap_or_else(Self::other)
    }

    /// Stands for every method that the server does not have.
    pub(super) fn other() -> &'static Self {
        &OTHER
    }

    /// Whether a call may last as long as its client wants.
    pub(super) fn is_long_lived(&self) -> bool {
        self.streams_requests || self.is_watch()
    }

    /// Whether the method is a stream that tools keep open: Watch of the health service, and reflection.
    pub(super) fn is_watch(&self) -> bool {
        self.streams_answers && self.service != Service::Contract
    }

    /// Whether the request is a single message.
    pub(super) fn takes_one_message(&self) -> bool {
        !self.streams_requests
    }

    /// Whether the method is a health check.
    pub(super) fn is_health(&self) -> bool {
        self.service == Service::Health
    }

    /// Whether the request's messages contain little more than the name of a service.
    pub(super) fn names_a_service(&self) -> bool {
        self.service != Service::Contract
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a metric label that clients can invent. Each new label would be a time series that never
    /// ends.
    #[test]
    fn methods_that_are_not_there_have_one_name() {
        assert_eq!(Method::of("/hullcast.v1.HullService/GetHulls").name, "hullcast.v1.HullService/GetHulls");
        for path in ["", "/", "other", "hullcast.v1.HullService/GetHulls", "/hullcast.v1.HullService/Get"] {
            assert_eq!(Method::of(path), Method::other(), "{path}");
        }
    }

    /// Catches a service whose descriptors cannot be read, so that its calls would lose their limits, and a
    /// method that counts as another kind: a Watch with a deadline, or a query without one.
    #[test]
    fn methods_have_the_rules_of_their_kind() {
        let those = |rule: fn(&Method) -> bool| -> Vec<&str> {
            METHODS.iter().filter(|method| rule(method)).map(|method| method.name.as_str()).collect()
        };
        let health = ["grpc.health.v1.Health/Check", "grpc.health.v1.Health/Watch"];
        let reflection = [
            "grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
            "grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
        ];
        let watch = ["grpc.health.v1.Health/Watch", reflection[0], reflection[1]];
        let stream = proto::methods::STREAM_CONTACTS;
        let sorted = |mut names: Vec<&'static str>| {
            names.sort_unstable();
            names
        };
        assert_eq!(METHODS.len(), 9 + 2 + 2);
        assert_eq!(sorted(those(Method::is_health)), health);
        assert_eq!(sorted(those(Method::is_watch)), watch);
        assert_eq!(sorted(those(Method::is_long_lived)), [&watch[..], &[stream]].concat());
        assert_eq!(sorted(those(|m| !m.takes_one_message())), [&reflection[..], &[stream]].concat());
        assert_eq!(sorted(those(Method::names_a_service)), [&health[..], &reflection].concat());
    }
}
