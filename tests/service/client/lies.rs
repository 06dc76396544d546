//! A server that lies: it passes calls on to the real server and spoils the answers. The real server gives no
//! such answers, but a proxy, a cache or another implementation may.

use std::future::ready;
use std::pin::Pin;
use std::sync::{Arc, Mutex};

use futures_util::{Stream, StreamExt};
use hullcast::proto::{
    DeleteHullsRequest, DeleteHullsResponse, Encoded, GetHullsRequest, GetHullsResponse,
    GetServerInfoRequest, GetServerInfoResponse, HasHullsRequest, HasHullsResponse, ListHullsRequest,
    ListHullsResponse, QueryContactsRequest, QueryContactsResponse, RegisterHullsRequest,
    RegisterHullsResponse,
    contact_service_server::{ContactService, ContactServiceServer},
    hull_service_server::{HullService, HullServiceServer},
    register_hull_result::Result as Registered,
    server_service_server::{ServerService, ServerServiceServer},
};
use hullcast_client::{Client, Error, HullPart};
use hyper_util::{
    rt::{TokioExecutor, TokioIo},
    service::TowerToHyperService,
};
use tokio::net::TcpListener;
use tonic::{Request, Response, Status, Streaming, service::Routes};

use super::{hulls, ids};
use crate::support::{
    TestServer,
    scenes::{scene, shapes},
};

type Answers = Pin<Box<dyn Stream<Item = Result<QueryContactsResponse, Status>> + Send>>;

/// The lie of the moment.
#[derive(Clone, Copy, Debug)]
pub(super) enum Lie {
    None,
    /// About every message of an answer to a query, a search or a step.
    Answer(fn(&mut QueryContactsResponse)),
    Registered(fn(&mut RegisterHullsResponse)),
    Present(fn(&mut HasHullsResponse)),
    Records(fn(&mut GetHullsResponse)),
    Deleted(fn(&mut DeleteHullsResponse)),
}

/// The services of the lying server.
#[derive(Clone)]
pub(super) struct Liar {
    real: Arc<TestServer>,
    lie: Arc<Mutex<Lie>>,
}

fn decoded<M: prost::Message + Default>(request: Request<Encoded<M>>) -> M {
    M::decode(request.into_inner().into_bytes()).unwrap()
}

impl Liar {
    pub(super) async fn start() -> (Self, Client) {
        let liar = Self { real: Arc::new(TestServer::start().await), lie: Arc::new(Mutex::new(Lie::None)) };
        let routes = Routes::default()
            .add_service(ContactServiceServer::new(liar.clone()))
            .add_service(HullServiceServer::new(liar.clone()))
            .add_service(ServerServiceServer::new(liar.clone()))
            .prepare();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let http = hyper::server::conn::http2::Builder::new(TokioExecutor::new());
                let service = TowerToHyperService::new(routes.clone());
                tokio::spawn(async move { http.serve_connection(TokioIo::new(stream), service).await });
            }
        });
        let client = Client::connect(address).await.unwrap();
        (liar, client)
    }

    pub(super) fn tell(&self, lie: Lie) {
        *self.lie.lock().unwrap() = lie;
    }

    fn lie(&self) -> Lie {
        *self.lie.lock().unwrap()
    }

    fn spoilt(&self, mut answer: QueryContactsResponse) -> QueryContactsResponse {
        if let Lie::Answer(spoil) = self.lie() {
            spoil(&mut answer);
        }
        answer
    }

    fn spoilt_stream(&self, answers: Streaming<QueryContactsResponse>) -> Response<Answers> {
        let liar = self.clone();
        Response::new(Box::pin(answers.map(move |answer| answer.map(|answer| liar.spoilt(answer)))))
    }
}

#[tonic::async_trait]
impl ContactService for Liar {
    type FindContactsStream = Answers;
    type StreamContactsStream = Answers;

    async fn query_contacts(
        &self,
        request: Request<Encoded<QueryContactsRequest>>,
    ) -> Result<Response<QueryContactsResponse>, Status> {
        let answer = self.real.contacts().query_contacts(decoded(request)).await?;
        Ok(answer.map(|answer| self.spoilt(answer)))
    }

    async fn find_contacts(
        &self,
        request: Request<Encoded<QueryContactsRequest>>,
    ) -> Result<Response<Answers>, Status> {
        let answers = self.real.contacts().find_contacts(decoded(request)).await?;
        Ok(self.spoilt_stream(answers.into_inner()))
    }

    async fn stream_contacts(
        &self,
        request: Request<Streaming<Encoded<QueryContactsRequest>>>,
    ) -> Result<Response<Answers>, Status> {
        let messages = request.into_inner();
        let messages = messages.filter_map(|message| ready(message.ok().map(|m| decoded(Request::new(m)))));
        let answers = self.real.contacts().stream_contacts(messages).await?;
        Ok(self.spoilt_stream(answers.into_inner()))
    }
}

#[tonic::async_trait]
impl HullService for Liar {
    async fn register_hulls(
        &self,
        request: Request<Encoded<RegisterHullsRequest>>,
    ) -> Result<Response<RegisterHullsResponse>, Status> {
        let mut answer = self.real.hulls().register_hulls(decoded(request)).await?;
        if let Lie::Registered(spoil) = self.lie() {
            spoil(answer.get_mut());
        }
        Ok(answer)
    }

    async fn get_hulls(
        &self,
        request: Request<Encoded<GetHullsRequest>>,
    ) -> Result<Response<GetHullsResponse>, Status> {
        let mut answer = self.real.hulls().get_hulls(decoded(request)).await?;
        if let Lie::Records(spoil) = self.lie() {
            spoil(answer.get_mut());
        }
        Ok(answer)
    }

    async fn has_hulls(
        &self,
        request: Request<Encoded<HasHullsRequest>>,
    ) -> Result<Response<HasHullsResponse>, Status> {
        let mut answer = self.real.hulls().has_hulls(decoded(request)).await?;
        if let Lie::Present(spoil) = self.lie() {
            spoil(answer.get_mut());
        }
        Ok(answer)
    }

    async fn list_hulls(
        &self,
        request: Request<Encoded<ListHullsRequest>>,
    ) -> Result<Response<ListHullsResponse>, Status> {
        self.real.hulls().list_hulls(decoded(request)).await
    }

    async fn delete_hulls(
        &self,
        request: Request<Encoded<DeleteHullsRequest>>,
    ) -> Result<Response<DeleteHullsResponse>, Status> {
        let mut answer = self.real.hulls().delete_hulls(decoded(request)).await?;
        if let Lie::Deleted(spoil) = self.lie() {
            spoil(answer.get_mut());
        }
        Ok(answer)
    }
}

#[tonic::async_trait]
impl ServerService for Liar {
    async fn get_server_info(
        &self,
        request: Request<Encoded<GetServerInfoRequest>>,
    ) -> Result<Response<GetServerInfoResponse>, Status> {
        self.real.info().get_server_info(decoded(request)).await
    }
}

#[track_caller]
fn assert_malformed<T>(answer: Result<T, Error>, name: &str) {
    match answer {
        Err(Error::Malformed(why)) => assert!(why.to_string().contains(name), "{name}: {why}"),
        Err(other) => panic!("{name}: {other:?}"),
        Ok(_) => panic!("{name}: accepted"),
    }
}

/// Catches an answer to another request, or one whose columns do not fit together, that reaches the caller;
/// and a session that goes on with a stream whose answers cannot be trusted.
#[tokio::test(flavor = "multi_thread")]
async fn wrong_answers_are_refused() {
    let (liar, client) = Liar::start().await;
    let shapes = shapes();
    client.register(&hulls(&shapes)).await.unwrap();
    let request = scene(&shapes, 20, 50, 1);
    let search = QueryContactsRequest { pairs: vec![], ..request.clone() };
    let mut session = client.session(request.clone(), vec![]);
    let mut positions: Vec<[f64; 3]> = request.positions.as_chunks().0.to_vec();
    let rotations: Vec<[f64; 4]> = request.rotations.as_chunks().0.to_vec();
    type Spoil = fn(&mut QueryContactsResponse);
    let lies: [(&str, Spoil); 5] = [
        ("request_id", |answer| answer.request_id += 1),
        ("outcomes", |answer| answer.outcomes.truncate(1)),
        ("witness_as", |answer| answer.witness_as.push(0.0)),
        ("alphas[0]", |answer| answer.alphas[0] = f64::NAN),
        ("missing_hulls[0]", |answer| answer.missing_hulls = vec![99]),
    ];
    for (name, lie) in lies {
        liar.tell(Lie::None);
        client.query(&request).await.unwrap();
        client.find_all(&search).await.unwrap();
        session.step(&positions, &rotations).await.unwrap();
        liar.tell(Lie::Answer(lie));
        assert_malformed(client.query(&request).await, name);
        assert_malformed(client.query_once(&request).await, name);
        assert_malformed(client.find(&search).await, name);
        // A body moves, because an answer that has not changed has no columns.
        positions[0][0] += 0.01;
        assert_malformed(session.step(&positions, &rotations).await, name);
    }
    liar.tell(Lie::Answer(|answer| answer.pairs.swap(0, 1)));
    assert_malformed(client.find(&search).await, "the lower first");
}

/// A server of an older version ignores the fields that it does not know, and sends no contract number. Catches its
/// answer to another question that reaches the caller, and an answer that is refused although it fits.
#[tokio::test(flavor = "multi_thread")]
async fn answers_of_a_server_that_is_too_old_are_refused() {
    let (liar, client) = Liar::start().await;
    let shapes = shapes();
    client.register(&hulls(&shapes)).await.unwrap();
    let plain = scene(&shapes, 20, 50, 1);
    let request = QueryContactsRequest { margins: vec![0.1; 20], ..plain.clone() };
    let search = QueryContactsRequest { pairs: vec![], ..request.clone() };
    let mut session = client.session(request.clone(), vec![]);
    let positions: Vec<[f64; 3]> = request.positions.as_chunks().0.to_vec();
    let rotations: Vec<[f64; 4]> = request.rotations.as_chunks().0.to_vec();
    client.query(&request).await.unwrap();
    session.step(&positions, &rotations).await.unwrap();
    liar.tell(Lie::Answer(|answer| answer.contract = 0));
    let version = client.info().await.unwrap().version;
    let too_old = Error::TooOld { version, contract: 0, needed: 1 };
    assert_eq!(client.query(&request).await.unwrap_err(), too_old);
    assert_eq!(client.query_once(&request).await.unwrap_err(), too_old);
    assert_eq!(client.find(&search).await.unwrap_err(), too_old);
    assert_eq!(session.step(&positions, &rotations).await.unwrap_err(), too_old);
    client.query(&plain).await.unwrap();
}

/// Catches a hull that is mistaken for another, and results that are given to the wrong hulls.
#[tokio::test(flavor = "multi_thread")]
async fn wrong_results_of_hulls_are_refused() {
    let (liar, client) = Liar::start().await;
    let hulls = hulls(&shapes());
    let ids = ids(&hulls);
    liar.tell(Lie::Registered(|answer| {
        let Some(Registered::Hull(info)) = &mut answer.results[1].result else { panic!("a hull") };
        info.id[0] ^= 1;
    }));
    assert_malformed(client.put(&hulls).await, "hulls[1]");
    liar.tell(Lie::Registered(|answer| drop(answer.results.pop())));
    assert_malformed(client.put(&hulls).await, "results has 4 entries, expected 5");
    liar.tell(Lie::Registered(|answer| answer.results[2].result = None));
    assert_malformed(client.put(&hulls).await, "results[2]");
    liar.tell(Lie::Present(|answer| answer.present.push(true)));
    assert_malformed(client.has(&ids).await, "present");
    assert_malformed(client.register(&hulls).await, "present");
    liar.tell(Lie::Records(|answer| answer.hulls.swap(0, 1)));
    assert_malformed(client.get(&ids, &[HullPart::Info]).await, &ids[0].to_string());
    liar.tell(Lie::Deleted(|answer| answer.deleted.clear()));
    assert_malformed(client.delete(&ids).await, "deleted");
}
