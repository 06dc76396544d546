package main

import (
	"bytes"
	"context"
	"fmt"

	pb "github.com/hullcast/hullcast/examples/go/hullcastv1"
	"google.golang.org/grpc"
)

// The server's default message limit in both directions. gRPC's own default is 4 MiB.
const maxMessageBytes = 64 << 20

// Client has the hull service and the contact service.
type Client struct {
	hulls    pb.HullServiceClient
	contacts pb.ContactServiceClient
}

func connect(target string, options ...grpc.DialOption) (Client, error) {
	sizes := grpc.WithDefaultCallOptions(
		grpc.MaxCallRecvMsgSize(maxMessageBytes), grpc.MaxCallSendMsgSize(maxMessageBytes))
	connection, err := grpc.NewClient(target, append(options, sizes)...)
	if err != nil {
		return Client{}, err
	}
	return Client{pb.NewHullServiceClient(connection), pb.NewContactServiceClient(connection)}, nil
}

// register returns the ids, after comparing them with those computed here.
func (c Client) register(ctx context.Context, hulls ...Hull) ([][]byte, error) {
	request := &pb.RegisterHullsRequest{}
	for _, hull := range hulls {
		request.Hulls = append(request.Hulls, &pb.HullDefinition{
			Vertices: hull.Vertices, ContractionPoint: hull.ContractionPoint,
			Simplification: hull.Simplification,
			Planarity:      hull.Planarity,
		})
	}
	response, err := c.hulls.RegisterHulls(ctx, request)
	if err != nil {
		return nil, err
	}
	var ids [][]byte
	for i, result := range response.Results {
		if refused := result.GetError(); refused != nil {
			return nil, fmt.Errorf("hull %d: %s: %s", i, refused.Reason, refused.Message)
		}
		id := result.GetHull().Id
		if !bytes.Equal(id, hulls[i].ID()) {
			return nil, fmt.Errorf("hull %d: the server's id is %x, not %x", i, id, hulls[i].ID())
		}
		ids = append(ids, id)
	}
	return ids, nil
}

// request is the request for the case's scene and its one pair.
func (c Case) request() *pb.QueryContactsRequest {
	a, b := c.A.hull().ID(), c.B.hull().ID()
	request := &pb.QueryContactsRequest{
		HullIds:   [][]byte{a, b},
		BodyHulls: []uint32{0, 1},
		Positions: append(c.A.Position[:], c.B.Position[:]...),
		Rotations: append(c.A.Rotation[:], c.B.Rotation[:]...),
		Pairs:     []uint32{0, 1},
		Margin:    c.margin(),
		Outputs:   []pb.Output{pb.Output_OUTPUT_ALPHA, pb.Output_OUTPUT_NORMAL, pb.Output_OUTPUT_POINTS},
	}
	if bytes.Equal(a, b) { // each hull is listed once
		request.HullIds, request.BodyHulls = [][]byte{a}, []uint32{0, 0}
	}
	return request
}
