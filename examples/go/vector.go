package main

import "math"

// Vector is a vector of three numbers.
type Vector [3]float64

func (a Vector) add(b Vector) Vector { return Vector{a[0] + b[0], a[1] + b[1], a[2] + b[2]} }
func (a Vector) sub(b Vector) Vector { return Vector{a[0] - b[0], a[1] - b[1], a[2] - b[2]} }
func (a Vector) times(s float64) Vector {
	return Vector{a[0] * s, a[1] * s, a[2] * s}
}
func (a Vector) dot(b Vector) float64 { return a[0]*b[0] + a[1]*b[1] + a[2]*b[2] }
func (a Vector) length() float64      { return math.Sqrt(a.dot(a)) }
func (a Vector) cross(b Vector) Vector {
	return Vector{a[1]*b[2] - a[2]*b[1], a[2]*b[0] - a[0]*b[2], a[0]*b[1] - a[1]*b[0]}
}

// rotate rotates v by the quaternion q, in the order x, y, z, w.
func rotate(q [4]float64, v Vector) Vector {
	axis, w := Vector{q[0], q[1], q[2]}, q[3]
	s := 2 / (axis.dot(axis) + w*w)
	turned := axis.cross(v)
	return v.add(turned.times(w * s)).add(axis.cross(turned).times(s))
}

func inverse(q [4]float64) [4]float64 { return [4]float64{-q[0], -q[1], -q[2], q[3]} }

// distanceToPolygon is the distance from p to a convex polygon in space.
func distanceToPolygon(p Vector, corners []Vector) float64 {
	var normal Vector
	next := func(i int) Vector { return corners[(i+1)%len(corners)] }
	for i := range corners {
		normal = normal.add(corners[i].sub(corners[0]).cross(next(i).sub(corners[0])))
	}
	inside, nearest := true, math.Inf(1)
	for i, start := range corners {
		side, to := next(i).sub(start), p.sub(start)
		inside = inside && normal.cross(side).dot(to) >= 0
		t := math.Max(0, math.Min(1, to.dot(side)/side.dot(side)))
		nearest = math.Min(nearest, to.sub(side.times(t)).length())
	}
	if inside {
		return math.Abs(p.sub(corners[0]).dot(normal)) / normal.length()
	}
	return nearest
}
