// Command conformance tests a server, and the generated code for Go, against the golden cases and
// the documented errors. It prints the number of checks of each kind.
//
//	go run . ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]
package main

import (
	"context"
	"fmt"
	"os"
	"time"

	"google.golang.org/grpc"
	"google.golang.org/grpc/credentials/insecure"
)

func main() {
	if len(os.Args) != 3 && len(os.Args) != 7 {
		fmt.Fprintln(os.Stderr, "conformance ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]")
		os.Exit(2)
	}
	if err := run(os.Args[1], os.Args[2], os.Args[3:]); err != nil {
		fmt.Fprintln(os.Stderr, "conformance:", err)
		os.Exit(1)
	}
}

func run(root, target string, secure []string) error {
	ctx, cancel := context.WithTimeout(context.Background(), time.Minute)
	defer cancel()
	cases, err := readCases(root)
	if err != nil {
		return err
	}
	client, err := connect(target, grpc.WithTransportCredentials(insecure.NewCredentials()))
	if err != nil {
		return err
	}
	checks := []struct {
		name string
		run  func() (int, error)
	}{
		{"identities", func() (int, error) { return checkIdentities(root) }},
		{"answers", func() (int, error) { return client.checkAnswers(ctx, cases) }},
		{"errors", func() (int, error) { return client.checkErrors(ctx, cases[0]) }},
		{"steps", func() (int, error) { return client.checkSteps(ctx, cases[0]) }},
		{"loops", func() (int, error) { return client.checkLoop(ctx, cases[0]) }},
		{"deadlines", func() (int, error) { return client.checkDeadline(ctx, cases[0]) }},
		{"secured", func() (int, error) { return checkSecured(ctx, secure, cases[0]) }},
	}
	for _, check := range checks {
		count, err := check.run()
		if err != nil {
			return fmt.Errorf("%s: %w", check.name, err)
		}
		fmt.Println(check.name, count)
	}
	return nil
}
