//! `ServerService`: what this server is and what it accepts.

use std::sync::Arc;

use tonic::{Request, Response, Status};

use super::{App, wire};
use crate::proto::{
    GetServerInfoRequest, GetServerInfoResponse,
    server_service_server::{ServerService, ServerServiceServer},
};

pub(super) fn service(app: Arc<App>) -> ServerServiceServer<impl ServerService> {
    ServerServiceServer::new(Info { app })
}

struct Info {
    app: Arc<App>,
}

#[tonic::async_trait]
impl ServerService for Info {
    async fn get_server_info(
        &self,
        _: Request<GetServerInfoRequest>,
    ) -> Result<Response<GetServerInfoResponse>, Status> {
        let (limits, threads) = (self.app.limits(), self.app.engine().threads());
        Ok(Response::new(wire::server_info(limits, threads, self.app.memory())))
    }
}
