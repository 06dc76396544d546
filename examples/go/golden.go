package main

import (
	"encoding/json"
	"fmt"
	"math"
	"os"
	"path/filepath"
	"strings"

	pb "github.com/hullcast/hullcast/examples/go/hullcastv1"
)

// Case is a case of tests/golden/contacts.json, which tests/golden/README.md describes.
type Case struct {
	Name         string
	A, B         Side
	Margin       *float64
	Outcome      string
	AlphaBelow   float64 `json:"alpha_below"`
	AlphaAbove   float64 `json:"alpha_above"`
	AlphaBudget  float64 `json:"alpha_budget"`
	LengthBudget float64 `json:"length_budget"`
	Patch        []Vector
	PatchBudget  float64 `json:"patch_budget"`
}

// Side is a hull at a pose.
type Side struct {
	Vertices         []Vector
	ContractionPoint Vector `json:"contraction_point"`
	Position         Vector
	Rotation         [4]float64
}

func (s Side) hull() Hull {
	hull := Hull{ContractionPoint: s.ContractionPoint[:]}
	for _, vertex := range s.Vertices {
		hull.Vertices = append(hull.Vertices, vertex[:]...)
	}
	return hull
}

// support is the largest n . (v - contraction point) over the vertices v; n is in the world frame.
func (s Side) support(n Vector) float64 {
	local, most := rotate(inverse(s.Rotation), n), math.Inf(-1)
	for _, vertex := range s.Vertices {
		most = math.Max(most, local.dot(vertex.sub(s.ContractionPoint)))
	}
	return most
}

func readCases(root string) ([]Case, error) {
	text, err := os.ReadFile(filepath.Join(root, "tests/golden/contacts.json"))
	if err != nil {
		return nil, err
	}
	var file struct {
		Format string
		Cases  []Case
	}
	if err := json.Unmarshal(text, &file); err != nil {
		return nil, err
	}
	if file.Format != "hullcast.golden.v1" {
		return nil, fmt.Errorf("golden cases of format %q", file.Format)
	}
	return file.Cases, nil
}

// IdentityVector is a test vector of docs/identity.md.
type IdentityVector struct {
	Name             string
	Vertices         []float64
	ContractionPoint []float64 `json:"contraction_point"`
	MaxVertices      *uint32   `json:"max_vertices"`
	MaxDeviation     *float64  `json:"max_deviation"`
	Planarity        *float64
	ID, Bytes        string
}

func (v IdentityVector) hull() Hull {
	hull := Hull{Vertices: v.Vertices, ContractionPoint: v.ContractionPoint, Planarity: v.Planarity}
	if v.MaxVertices != nil || v.MaxDeviation != nil {
		hull.Simplification = &pb.Simplification{MaxVertices: v.MaxVertices, MaxDeviation: v.MaxDeviation}
	}
	return hull
}

func readIdentityVectors(root string) (vectors []IdentityVector, err error) {
	text, err := os.ReadFile(filepath.Join(root, "docs/identity.md"))
	if err != nil {
		return nil, err
	}
	_, block, _ := strings.Cut(string(text), "```json\n")
	block, _, _ = strings.Cut(block, "```")
	return vectors, json.Unmarshal([]byte(block), &vectors)
}

// check compares the answer for the case's one pair with the exact one.
func (c Case) check(answer *pb.QueryContactsResponse) error {
	outcome := pb.Outcome(answer.Outcomes[0])
	if outcome.String() != "OUTCOME_"+c.Outcome {
		return fmt.Errorf("outcome %v, not %s", outcome, c.Outcome)
	}
	alpha, lower, upper := answer.Alphas[0], answer.AlphaLowers[0], answer.AlphaUppers[0]
	if lower > c.AlphaBelow || upper < c.AlphaAbove {
		return fmt.Errorf("alpha %v is not in [%v, %v]", c.AlphaBelow, lower, upper)
	}
	if c.Outcome == "SEPARATED" {
		return nil
	}
	// Twice the budgets, because the numbers computed here are rounded too.
	if math.Abs(alpha-c.AlphaBelow) > 2*c.AlphaBudget {
		return fmt.Errorf("alpha %v, not %v", alpha, c.AlphaBelow)
	}
	n := Vector(answer.Normals)
	centres := c.B.Position.sub(c.A.Position).
		add(rotate(c.B.Rotation, c.B.ContractionPoint)).
		sub(rotate(c.A.Rotation, c.A.ContractionPoint))
	reach := c.A.support(n) + c.B.support(n.times(-1))
	if math.Abs(n.length()-1) > 1e-15 || c.AlphaBelow-n.dot(centres)/reach > 2*c.AlphaBudget {
		return fmt.Errorf("normal %v is not optimal", n)
	}
	if separation := n.dot(centres) - reach; math.Abs(answer.Separations[0]-separation) > 2*c.LengthBudget {
		return fmt.Errorf("separation %v, not %v", answer.Separations[0], separation)
	}
	return c.checkPoints(answer)
}

func (c Case) checkPoints(answer *pb.QueryContactsResponse) error {
	count := int(answer.PointCounts[0])
	if count == 0 || len(answer.Distances) != count || len(answer.WitnessAs) != 3*count {
		return fmt.Errorf("%d points, %d distances", count, len(answer.Distances))
	}
	if c.Patch == nil {
		return nil
	}
	var found []Vector
	for i := range count {
		found = append(found, Vector(answer.WitnessAs[3*i:]))
	}
	if pb.Flag(answer.Flags[0])&pb.Flag_FLAG_ESTIMATED != 0 || count < 3 {
		return fmt.Errorf("no patch: %d points", count)
	}
	far := 0.0
	for _, p := range found {
		far = math.Max(far, distanceToPolygon(p, c.Patch))
	}
	for _, p := range c.Patch {
		far = math.Max(far, distanceToPolygon(p, found))
	}
	if far > c.PatchBudget {
		return fmt.Errorf("patch is %v from the exact one", far)
	}
	return nil
}

func (c Case) margin() float64 {
	if c.Margin == nil {
		return math.Inf(1)
	}
	return *c.Margin
}
