package main

import (
	"bytes"
	"crypto/sha256"
	"encoding/binary"

	pb "github.com/hullcast/hullcast/examples/go/hullcastv1"
)

// Hull is a cloud of points to register: three numbers per point, in the hull's own frame.
type Hull struct {
	Vertices []float64
	// Three numbers; or empty for the centre of mass.
	ContractionPoint []float64
	// Nil for no simplification.
	Simplification *pb.Simplification
	// If nil, the server uses 1e-6.
	Planarity *float64
}

// IdentityBytes is the byte string that docs/identity.md defines.
func (h Hull) IdentityBytes() []byte {
	var out bytes.Buffer
	out.WriteString("hullcast")
	write := func(value any) { _ = binary.Write(&out, binary.LittleEndian, value) }
	numbers := func(values []float64) {
		for _, value := range values {
			write(value + 0) // -0.0 is written as 0.0
		}
	}
	version := uint32(1)
	if h.Planarity != nil {
		version = 2
	}
	write(version)
	if len(h.ContractionPoint) == 0 {
		write(uint8(0))
	} else {
		write(uint8(1))
		numbers(h.ContractionPoint)
	}
	if limits := h.Simplification; limits == nil {
		write(uint8(0))
	} else {
		write(uint8(1))
		write(limits.MaxVertices != nil)
		if limits.MaxVertices != nil {
			write(*limits.MaxVertices)
		}
		write(limits.MaxDeviation != nil)
		if limits.MaxDeviation != nil {
			numbers([]float64{*limits.MaxDeviation})
		}
	}
	if h.Planarity != nil {
		numbers([]float64{*h.Planarity})
	}
	write(uint32(len(h.Vertices) / 3))
	numbers(h.Vertices)
	return out.Bytes()
}

// ID is the hull's id on every server: 32 bytes.
func (h Hull) ID() []byte {
	sum := sha256.Sum256(h.IdentityBytes())
	return sum[:]
}
