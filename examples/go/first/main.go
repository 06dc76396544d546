package main

import (
	"context"
	"fmt"
	"log"
	"os"

	pb "github.com/hullcast/hullcast/examples/go/hullcastv1"
	"google.golang.org/grpc"
	"google.golang.org/grpc/credentials/insecure"
)

func main() {
	connection, err := grpc.NewClient(os.Args[1], grpc.WithTransportCredentials(insecure.NewCredentials()))
	must(err)
	cube := []float64{0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1, 0, 1, 1, 1, 0, 1, 1, 1}
	registered, err := pb.NewHullServiceClient(connection).RegisterHulls(context.Background(),
		&pb.RegisterHullsRequest{Hulls: []*pb.HullDefinition{{Vertices: cube}}})
	must(err)
	m, err := pb.NewContactServiceClient(connection).QueryContacts(context.Background(), &pb.QueryContactsRequest{
		HullIds:   [][]byte{registered.Results[0].GetHull().GetId()},
		BodyHulls: []uint32{0, 0}, // both bodies are the cube
		Positions: []float64{0, 0, 0, 0.2, 0, 0.99},
		Rotations: []float64{0, 0, 0, 1, 0, 0, 0, 1},
		Pairs:     []uint32{0, 1},
		Margin:    0.01,
	})
	must(err)
	fmt.Printf("alpha %.2f, separation %.2f, %d points\n", m.Alphas[0], m.Separations[0], m.PointCounts[0])
}

func must(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
