package main

import (
	"bytes"
	"crypto/sha256"
	"encoding/binary"
)

// Hull is a cloud of points to register, three numbers a point, in the hull's own frame.
type Hull struct {
	Vertices []float64
	// Empty (the centre of mass is taken) or three numbers.
	ContractionPoint []float64
}

// IdentityBytes is the byte string of docs/identity.md.
func (h Hull) IdentityBytes() []byte {
	var out bytes.Buffer
	out.WriteString("hullcast")
	write := func(value any) { _ = binary.Write(&out, binary.LittleEndian, value) }
	numbers := func(values []float64) {
		for _, value := range values {
			write(value + 0) // -0.0 is written as 0.0
		}
	}
	write(uint32(1)) // the format's version
	if len(h.ContractionPoint) == 0 {
		write(uint8(0))
	} else {
		write(uint8(1))
		numbers(h.ContractionPoint)
	}
	write(uint8(0)) // no simplification
	write(uint32(len(h.Vertices) / 3))
	numbers(h.Vertices)
	return out.Bytes()
}

// ID names the hull on every server.
func (h Hull) ID() []byte {
	sum := sha256.Sum256(h.IdentityBytes())
	return sum[:]
}
