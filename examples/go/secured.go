package main

import (
	"context"
	"fmt"

	"google.golang.org/grpc"
	"google.golang.org/grpc/codes"
	"google.golang.org/grpc/credentials"
	"google.golang.org/grpc/status"
)

// token is sent with every call, and only over TLS.
type token string

func (t token) GetRequestMetadata(context.Context, ...string) (map[string]string, error) {
	return map[string]string{"authorization": "Bearer " + string(t)}, nil
}

func (t token) RequireTransportSecurity() bool { return true }

// checkSecured calls a server with TLS and tokens. The client must trust its authority and send a
// token, and the token's role must allow the call.
func checkSecured(ctx context.Context, arguments []string, golden Case) (int, error) {
	if len(arguments) == 0 {
		return 0, nil
	}
	target, registers, queries := arguments[0], token(arguments[2]), token(arguments[3])
	trusted, err := credentials.NewClientTLSFromFile(arguments[1], "")
	if err != nil {
		return 0, err
	}
	tls := grpc.WithTransportCredentials(trusted)
	hull := golden.A.hull()
	for count, attempt := range []struct {
		options []grpc.DialOption
		code    codes.Code
	}{
		{[]grpc.DialOption{grpc.WithTransportCredentials(credentials.NewTLS(nil))}, codes.Unavailable},
		{[]grpc.DialOption{tls}, codes.Unauthenticated},
		{[]grpc.DialOption{tls, grpc.WithPerRPCCredentials(token("none"))}, codes.Unauthenticated},
		{[]grpc.DialOption{tls, grpc.WithPerRPCCredentials(queries)}, codes.PermissionDenied},
		{[]grpc.DialOption{tls, grpc.WithPerRPCCredentials(registers)}, codes.OK},
	} {
		client, err := connect(target, attempt.options...)
		if err != nil {
			return 0, err
		}
		if _, err := client.register(ctx, hull); status.Code(err) != attempt.code {
			return 0, fmt.Errorf("attempt %d: %v", count, err)
		}
	}
	client, err := connect(target, tls, grpc.WithPerRPCCredentials(queries))
	if err != nil {
		return 0, err
	}
	answer, err := client.contacts.QueryContacts(ctx, golden.request())
	if err != nil {
		return 0, err
	}
	return 6, golden.check(answer)
}
