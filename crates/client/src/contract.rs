//! Refuses the answers of servers that do not know fields of the request.
//!
//! A server ignores the fields that it does not know, and would answer another question. Each answer therefore
//! carries the contract number of its server, which rises whenever a field is added that changes answers.

use hullcast_proto::{Output, QueryContactsRequest, QueryContactsResponse};

use crate::client::Deadline;
use crate::{Client, Error};

/// The contract number from which a server knows `find`, `moved`, `previous_bodies`, the output MATCHES, margins of
/// bodies and velocities.
pub(crate) const LOOP_CONTRACT: u32 = 1;

/// The least contract number of a server that knows the fields of this request.
pub(crate) fn needed(request: &QueryContactsRequest) -> u32 {
    let of_contract_1 = request.find
        || request.time_step != 0.0
        || request.outputs.contains(&Output::Matches.into())
        || [
            &request.margins,
            &request.linear_velocities,
            &request.angular_velocities,
            &request.turning_points,
        ]
        .iter()
        .any(|column| !column.is_empty())
        || [&request.moved, &request.previous_bodies].iter().any(|column| !column.is_empty());
    if of_contract_1 { LOOP_CONTRACT } else { 0 }
}

impl Client {
    /// Checks that the server which gave `answer` knows the fields of `request`.
    ///
    /// # Errors
    /// [`Error::TooOld`], with the server's version.
    pub(crate) async fn check_contract(
        &self,
        deadline: Deadline,
        request: &QueryContactsRequest,
        answer: &QueryContactsResponse,
    ) -> Result<(), Error> {
        let (needed, contract) = (needed(request), answer.contract);
        if contract >= needed {
            return Ok(());
        }
        let version = self.info_by(deadline).await?.version;
        Err(Error::TooOld { version, contract, needed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a field of the second contract whose answer an old server could give unnoticed, and an answer to
    /// an old request that is refused.
    #[test]
    fn new_fields_need_a_new_server() {
        assert_eq!(needed(&QueryContactsRequest { margin: 1.0, worlds: vec![0], ..Default::default() }), 0);
        type Set = fn(&mut QueryContactsRequest);
        let set: [Set; 9] = [
            |r| r.find = true,
            |r| r.outputs = vec![Output::Matches.into()],
            |r| r.moved = vec![0],
            |r| r.margins = vec![0.0],
            |r| r.linear_velocities = vec![0.0],
            |r| r.angular_velocities = vec![0.0],
            |r| r.time_step = 1.0,
            |r| r.turning_points = vec![0.0],
            |r| r.previous_bodies = vec![0],
        ];
        for (number, set) in set.iter().enumerate() {
            let mut request = QueryContactsRequest::default();
            set(&mut request);
            assert_eq!(needed(&request), 1, "{number}");
        }
    }
}
