package main

import (
	"context"
	"encoding/hex"
	"fmt"
	"io"
	"math"
	"slices"
	"time"

	pb "github.com/hullcast/hullcast/examples/go/hullcastv1"
	"google.golang.org/genproto/googleapis/rpc/errdetails"
	"google.golang.org/grpc/codes"
	"google.golang.org/grpc/status"
	"google.golang.org/protobuf/proto"
)

func checkIdentities(root string) (int, error) {
	vectors, err := readIdentityVectors(root)
	for _, vector := range vectors {
		hull := vector.hull()
		if id := hex.EncodeToString(hull.ID()); id != vector.ID {
			return 0, fmt.Errorf("%s: %s", vector.Name, id)
		}
		if bytes := hex.EncodeToString(hull.IdentityBytes()); vector.Bytes != "" && bytes != vector.Bytes {
			return 0, fmt.Errorf("%s: %s", vector.Name, bytes)
		}
	}
	return len(vectors), err
}

// checkAnswers queries every case with both solvers.
func (c Client) checkAnswers(ctx context.Context, cases []Case) (count int, err error) {
	for _, golden := range cases {
		if _, err := c.register(ctx, golden.A.hull(), golden.B.hull()); err != nil {
			return 0, err
		}
		for _, solver := range []pb.Solver{pb.Solver_SOLVER_PORTAL, pb.Solver_SOLVER_GJK_RAY_CAST} {
			request := golden.request()
			request.Accuracy = &pb.Accuracy{Solver: solver}
			answer, err := c.contacts.QueryContacts(ctx, request)
			if err == nil {
				err = golden.check(answer)
			}
			if err != nil {
				return 0, fmt.Errorf("%s with %v: %w", golden.Name, solver, err)
			}
			count++
		}
	}
	return count, nil
}

// refusal describes an error by its code, reason and field.
func refusal(err error) string {
	said := status.Convert(err)
	reason, field := "", ""
	for _, detail := range said.Details() {
		switch detail := detail.(type) {
		case *errdetails.ErrorInfo:
			reason = detail.Domain + "/" + detail.Reason
		case *errdetails.BadRequest:
			field = detail.FieldViolations[0].Field
		}
	}
	return fmt.Sprintf("%v %s %s", said.Code(), reason, field)
}

func expect(err error, wanted string) error {
	if said := refusal(err); said != wanted {
		return fmt.Errorf("%q, not %q (%v)", said, wanted, err)
	}
	return nil
}

func (c Client) checkErrors(ctx context.Context, golden Case) (int, error) {
	outside := golden.request()
	outside.Pairs = []uint32{0, 1, 1, 7}
	_, err := c.contacts.QueryContacts(ctx, outside)
	if err := expect(err, "InvalidArgument hullcast/INDEX_OUT_OF_RANGE pairs[3]"); err != nil {
		return 0, err
	}
	short := golden.request()
	short.Rotations = short.Rotations[1:]
	_, err = c.contacts.QueryContacts(ctx, short)
	if err := expect(err, "InvalidArgument hullcast/LENGTH_MISMATCH rotations"); err != nil {
		return 0, err
	}
	inherits := &pb.QueryContactsRequest{Inherit: true}
	_, err = c.stream(ctx, inherits)
	if err := expect(err, "InvalidArgument hullcast/NOTHING_TO_INHERIT inherit"); err != nil {
		return 0, err
	}
	// One invalid hull does not affect the other.
	flat := &pb.HullDefinition{Vertices: []float64{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0}}
	good := &pb.HullDefinition{Vertices: golden.A.hull().Vertices}
	registered, err := c.hulls.RegisterHulls(ctx, &pb.RegisterHullsRequest{Hulls: []*pb.HullDefinition{flat, good}})
	if err != nil {
		return 0, err
	}
	refused := registered.Results[0].GetError()
	if refused.GetReason() != "COPLANAR" || refused.GetField() != "vertices" || registered.Results[1].GetHull() == nil {
		return 0, fmt.Errorf("a flat hull: %v", registered.Results)
	}
	// Nor does an unknown hull affect the pairs of other hulls.
	unknown := golden.request()
	unknown.HullIds = append(unknown.HullIds, make([]byte, 32))
	unknown.BodyHulls = append(unknown.BodyHulls, uint32(len(unknown.HullIds)-1))
	unknown.Positions = append(unknown.Positions, 0, 0, 0)
	unknown.Rotations = append(unknown.Rotations, 0, 0, 0, 1)
	unknown.Pairs = []uint32{0, 1, 0, 2}
	answer, err := c.contacts.QueryContacts(ctx, unknown)
	if err != nil {
		return 0, err
	}
	outcomes := []byte{byte(pb.Outcome_OUTCOME_CONTACT), byte(pb.Outcome_OUTCOME_INVALID)}
	if !slices.Equal(answer.Outcomes, outcomes) || answer.Flags[1] != byte(pb.Flag_FLAG_UNKNOWN_HULL) ||
		!slices.Equal(answer.MissingHulls, unknown.BodyHulls[2:]) {
		return 0, fmt.Errorf("an unknown hull: %v", answer)
	}
	return 5, nil
}

// stream sends each request after the answer to the previous one.
func (c Client) stream(ctx context.Context, requests ...*pb.QueryContactsRequest) (answers []*pb.QueryContactsResponse, err error) {
	stream, err := c.contacts.StreamContacts(ctx)
	if err != nil {
		return nil, err
	}
	for _, request := range requests {
		if err := stream.Send(request); err != nil && err != io.EOF {
			return nil, err
		}
		answer, err := stream.Recv()
		if err != nil {
			return nil, err
		}
		answers = append(answers, answer)
	}
	if err := stream.CloseSend(); err != nil {
		return nil, err
	}
	if _, err := stream.Recv(); err != io.EOF {
		return nil, fmt.Errorf("the stream's end: %v", err)
	}
	return answers, nil
}

// checkSteps sends only poses after a stream's first message. Each answer must equal that of the
// full request with the previous bases as warm starts.
func (c Client) checkSteps(ctx context.Context, golden Case) (int, error) {
	const steps = 8
	full := golden.request()
	full.Outputs = append(full.Outputs, pb.Output_OUTPUT_BASES)
	requests := []*pb.QueryContactsRequest{full}
	for step := 1; step < steps; step++ {
		poses := &pb.QueryContactsRequest{RequestId: uint64(step), Inherit: true, Rotations: full.Rotations}
		poses.Positions = slices.Clone(full.Positions)
		poses.Positions[3] += 0.01 * float64(step)
		requests = append(requests, poses)
	}
	answers, err := c.stream(ctx, requests...)
	if err != nil {
		return 0, err
	}
	for step, answer := range answers {
		whole := proto.Clone(full).(*pb.QueryContactsRequest)
		whole.RequestId, whole.Positions = uint64(step), requests[step].Positions
		if step > 0 {
			whole.WarmStarts = answers[step-1].Bases
		}
		same, err := c.contacts.QueryContacts(ctx, whole)
		if err != nil {
			return 0, err
		}
		if len(answer.Alphas) != 1 || !proto.Equal(answer, same) {
			return 0, fmt.Errorf("step %d: %v, not %v", step, answer, same)
		}
	}
	return len(answers), nil
}

// checkLoop makes four steps in which the server finds the pairs: all bodies, none moved, one moved away, and one
// removed while a new one comes. The matches say what became of the pair of the step before.
func (c Client) checkLoop(ctx context.Context, golden Case) (int, error) {
	const none = math.MaxUint32
	all := golden.request()
	all.Find, all.Pairs = true, nil
	all.Outputs = append(all.Outputs, pb.Output_OUTPUT_MATCHES)
	away := append([]float64{all.Positions[3] + 1e6}, all.Positions[4:6]...)
	still := &pb.QueryContactsRequest{Inherit: true}
	moved := &pb.QueryContactsRequest{Inherit: true, Moved: []uint32{1}, Positions: away, Rotations: all.Rotations[4:8]}
	replaced := proto.Clone(all).(*pb.QueryContactsRequest)
	replaced.PreviousBodies = []uint32{0, none}
	answers, err := c.stream(ctx, all, still, moved, replaced)
	if err != nil {
		return 0, err
	}
	named, err := c.contacts.QueryContacts(ctx, golden.request())
	if err != nil {
		return 0, err
	}
	if !slices.Equal(answers[0].Alphas, named.Alphas) {
		return 0, fmt.Errorf("the found pair: %v, not %v", answers[0], named)
	}
	pair, nothing := []uint32{0, 1}, []uint32{}
	for step, wanted := range [][3][]uint32{
		{pair, {none}, nothing}, {pair, {0}, nothing}, {nothing, nothing, pair}, {pair, {none}, nothing},
	} {
		answer := answers[step]
		found := [][]uint32{answer.Pairs, answer.PreviousPairs, answer.EndedPairs}
		if !slices.EqualFunc(found, wanted[:], slices.Equal) {
			return 0, fmt.Errorf("step %d: %v, not %v", step, found, wanted)
		}
	}
	return len(answers), nil
}

// checkDeadline sends a request that takes many times its deadline.
func (c Client) checkDeadline(ctx context.Context, golden Case) (int, error) {
	request := golden.request()
	request.Pairs = slices.Repeat(request.Pairs, 131072)
	soon, cancel := context.WithTimeout(ctx, time.Millisecond)
	defer cancel()
	if _, err := c.contacts.QueryContacts(soon, request); status.Code(err) != codes.DeadlineExceeded {
		return 0, fmt.Errorf("a passed deadline: %v", err)
	}
	return 1, nil
}
