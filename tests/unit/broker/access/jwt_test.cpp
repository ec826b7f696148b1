// SPDX-License-Identifier: MIT
#include "broker/access/jwt.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>

#include "broker/access/policy.h"
#include "common/core/text.h"
#include "tests/unit/broker/access/golden_tokens.h"

namespace eigencast::broker {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::kNow;
using testing::kSecret;
namespace golden = testing;

std::string base64url(const std::string& bytes) {
  return base64_from_bytes(Bytes(bytes.begin(), bytes.end()), Base64::kUrl);
}

TokenKey secret_key(const std::string& id = "main", const std::string& secret = kSecret) {
  return TokenKey::from_secret(id, secret).value();
}

TokenRules rules_with(std::vector<TokenKey> keys) {
  TokenRules rules;
  rules.keys = std::move(keys);
  rules.audience = "eigencast";
  rules.leeway_s = 30;
  return rules;
}

/// A token of any header and claims, signed by an HMAC key whatever they say.
std::string signed_by(const TokenKey& key, const std::string& header, const std::string& claims) {
  const std::string text = base64url(header) + "." + base64url(claims);
  const auto signature = key.sign(text).value();
  return text + "." + base64url(std::string(signature.begin(), signature.end()));
}

std::string claims_with(const std::string& more) {
  return R"({"aud":"eigencast","exp":1800000100,"eigencast":{"sub":["**"]})" + (more.empty() ? "" : "," + more) + "}";
}

constexpr const char* kHeader = R"({"alg":"HS256","kid":"main"})";

std::string why(const Result<Claims>& result) {
  return result ? "accepted" : result.error().message;
}

std::string why_claims(const std::string& claims) {
  return why(verify_token(signed_by(secret_key(), kHeader, claims), rules_with({secret_key()}), kNow));
}

std::string why_header(const std::string& header) {
  return why(verify_token(signed_by(secret_key(), header, claims_with("")), rules_with({secret_key()}), kNow));
}

struct Golden {
  Algorithm algorithm;
  const char* key;
  const char* token;
};
const Golden kGolden[] = {{Algorithm::kRs256, golden::kGoldenRs256Key, golden::kGoldenRs256Token},
                          {Algorithm::kEs256, golden::kGoldenEs256Key, golden::kGoldenEs256Token},
                          {Algorithm::kEdDsa, golden::kGoldenEdDsaKey, golden::kGoldenEdDsaToken}};

TEST(JwtTest, TokensOfOtherImplementationsAreAccepted) {
  for (const Golden& one : kGolden) {
    const auto key = TokenKey::from_pem("golden", one.algorithm, one.key);
    ASSERT_TRUE(key) << key.error().message;
    EXPECT_FALSE(key->can_sign());
    const auto claims = verify_token(one.token, rules_with({*key}), kNow);
    ASSERT_TRUE(claims) << kAlgorithms[one.algorithm] << ": " << claims.error().message;
    EXPECT_EQ(claims->subject, "camera-1");
    EXPECT_TRUE(claims->rights.publish.matches("lab/horse"));
    EXPECT_FALSE(claims->rights.publish.matches("other"));
    EXPECT_TRUE(claims->rights.subscribe.matches("other"));
    EXPECT_FALSE(claims->rights.admin);
  }
  const auto key = secret_key("golden", golden::kGoldenSecret);
  EXPECT_EQ(why(verify_token(golden::kGoldenHs256Token, rules_with({key}), kNow)), "accepted");
}

// RFC 7515, appendix A.1, and RFC 8037, appendix A.4.
TEST(JwtTest, MatchesVectorsOfTheStandards) {
  std::string secret(
      "\x03\x23\x35\x4b\x2b\x0f\xa5\xbc\x83\x7e\x06\x65\x77\x7b\xa6\x8f\x5a\xb3\x28\xe6\xf0\x54\xc9\x28\xa9\x0f\x84\xb2"
      "\xd2\x50"
      "\x2e\xbf\xd3\xfb\x5a\x92\xd2\x06\x47\xef\x96\x8a\xb4\xc3\x77\x62\x3d\x22\x3d\x2e\x21\x72\x05\x2e\x4f\x08\xc0\xcd"
      "\x9a\xf5"
      "\x67\xd0\x80\xa3",
      64);
  const Bytes signature =
      secret_key("a", secret)
          .sign(
              "eyJ0eXAiOiJKV1QiLA0KICJhbGciOiJIUzI1NiJ9.eyJpc3MiOiJqb2UiLA0KICJleHAiOjEzMDA4MTkzODAsDQogImh0"
              "dHA6Ly9leGFtcGxlLmNvbS9pc19yb290Ijp0cnVlfQ")
          .value();
  EXPECT_EQ(base64url(std::string(signature.begin(), signature.end())), "dBjftJeZ4CVP-mB92K27uhbUJU1p1r_wW1gFWFOEjXk");

  const auto ed = TokenKey::from_pem(
      "a", Algorithm::kEdDsa,
      "-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n"
      "-----END PRIVATE KEY-----\n");
  ASSERT_TRUE(ed) << ed.error().message;
  const Bytes made = ed->sign("eyJhbGciOiJFZERTQSJ9.RXhhbXBsZSBvZiBFZDI1NTE5IHNpZ25pbmc").value();
  EXPECT_EQ(base64url(std::string(made.begin(), made.end())),
            "hgyY0il_MGCjP0JzlnLWG1PPOt7-09PGcvMg3AIbQR6dWbhijcNR4ki4iylGjg5BhVsPt9g7sVvpAr_MuM0KAg");
}

TEST(JwtTest, AlgorithmNoneIsRefused) {
  for (const char* alg : {"none", "None", "NONE", ""}) {
    const std::string header = std::string(R"({"alg":")") + alg + R"(","kid":"main"})";
    const std::string unsigned_token = base64url(header) + "." + base64url(claims_with("")) + ".";
    EXPECT_THAT(why(verify_token(unsigned_token, rules_with({secret_key()}), kNow)), HasSubstr("\"alg\""));
    EXPECT_THAT(why_header(header), HasSubstr("\"alg\""));
  }
  EXPECT_THAT(why_header(R"({"kid":"main"})"), HasSubstr("\"alg\""));
  EXPECT_THAT(why_header(R"({"alg":["HS256"],"kid":"main"})"), HasSubstr("\"alg\""));
}

TEST(JwtTest, PublicKeyIsNotASecret) {
  // The classic attack: an HMAC over the text of the RSA key that everybody knows.
  for (const Golden& one : kGolden) {
    EXPECT_FALSE(TokenKey::from_secret("golden", one.key)) << "a PEM file must not be taken as a secret";
    const auto key = TokenKey::from_pem("golden", one.algorithm, one.key).value();
    const auto forger = TokenKey::from_secret("golden", std::string(one.key).substr(11)).value();
    const std::string forged = signed_by(forger, R"({"alg":"HS256","kid":"golden"})", claims_with(""));
    EXPECT_THAT(why(verify_token(forged, rules_with({key}), kNow)), HasSubstr("\"alg\""));
    const std::string lied = signed_by(
        forger, R"({"alg":")" + std::string(kAlgorithms[one.algorithm]) + R"(","kid":"golden"})", claims_with(""));
    EXPECT_EQ(verify_token(lied, rules_with({key}), kNow).error().code, ErrorCode::kRefused);
  }
}

TEST(JwtTest, KeyServesOneAlgorithm) {
  for (const Golden& one : kGolden) {
    for (const Golden& other : kGolden) {
      const auto key = TokenKey::from_pem("golden", other.algorithm, one.key);
      EXPECT_EQ(key.has_value(), one.algorithm == other.algorithm);
      if (!key) continue;
      for (const Golden& token : kGolden) {
        EXPECT_EQ(verify_token(token.token, rules_with({*key}), kNow).has_value(), token.algorithm == key->algorithm());
      }
    }
    EXPECT_FALSE(TokenKey::from_pem("golden", Algorithm::kHs256, one.key));
  }
  EXPECT_FALSE(TokenKey::from_pem("x", Algorithm::kEs256, "no key"));
  EXPECT_FALSE(TokenKey::from_secret("x", "short"));
  EXPECT_FALSE(kAlgorithms.find("hs256"));
  EXPECT_FALSE(kAlgorithms.find("none"));
}

TEST(JwtTest, UnknownKeysAreRefused) {
  EXPECT_THAT(why_header(R"({"alg":"HS256","kid":"other"})"), HasSubstr("'other' (\"kid\")"));
  EXPECT_THAT(why_header(R"({"alg":"HS256","kid":7})"), HasSubstr("\"kid\""));
  EXPECT_EQ(why_header(R"({"alg":"HS256"})"), "accepted") << "the only key there is";
  const auto two = rules_with({secret_key("a"), secret_key("b")});
  EXPECT_THAT(why(verify_token(signed_by(secret_key("a"), R"({"alg":"HS256"})", claims_with("")), two, kNow)),
              HasSubstr("\"kid\""));
  EXPECT_THAT(why(verify_token(signed_by(secret_key(), kHeader, claims_with("")), rules_with({}), kNow)),
              HasSubstr("'main' (\"kid\")"));
}

TEST(JwtTest, CriticalExtensionsAreRefused) {
  EXPECT_THAT(why_header(R"({"alg":"HS256","kid":"main","crit":["b64"],"b64":false})"), HasSubstr("\"crit\""));
}

TEST(JwtTest, LeewayExtendsBothTimes) {
  const auto rules = rules_with({secret_key()});
  const std::string token = signed_by(secret_key(), kHeader, claims_with(R"("nbf":1799999900)"));
  const auto at = [&](std::int64_t now) { return why(verify_token(token, rules, now)); };
  EXPECT_THAT(at(1'799'999'869), HasSubstr("\"nbf\""));
  EXPECT_EQ(at(1'799'999'870), "accepted");
  EXPECT_EQ(at(1'800'000'129), "accepted");
  EXPECT_THAT(at(1'800'000'130), HasSubstr("\"exp\""));
}

TEST(JwtTest, ClaimsOfWrongTypesAreRefused) {
  EXPECT_EQ(why_claims(claims_with("")), "accepted");
  const char* wrong[] = {
      R"({"aud":"eigencast","eigencast":{}})",
      R"({"aud":"eigencast","exp":"1800000100","eigencast":{}})",
      R"({"aud":"eigencast","exp":null,"eigencast":{}})",
      R"({"aud":"eigencast","exp":-1,"eigencast":{}})",
      R"({"aud":"eigencast","exp":1e300,"eigencast":{}})",
      R"({"aud":"eigencast","exp":18446744073709551615,"eigencast":{}})",
      R"({"aud":"eigencast","exp":1800000100,"nbf":"now","eigencast":{}})",
      R"({"aud":"eigencast","exp":1800000100})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":[]})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"pub":"**"}})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"pub":[1]}})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"sub":["a//b"]}})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"admin":1}})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"admin":"false"}})",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{"subs":["**"]}})",
      R"({"aud":"eigencast","exp":1800000100,"sub":7,"eigencast":{}})",
      R"({"aud":"eigencast","exp":1800000100,"sub":"a\nb","eigencast":{}})",
      R"([1])",
      R"("text")",
      R"({"aud":"eigencast","exp":1800000100,"eigencast":{}} )"
      "x",
      "",
  };
  for (const char* claims : wrong) EXPECT_NE(why_claims(claims), "accepted") << claims;
  EXPECT_EQ(why_claims(R"({"aud":"eigencast","exp":1800000100.5,"eigencast":{}})"), "accepted");
}

TEST(JwtTest, AudienceAndIssuerAreChecked) {
  const auto with = [](const std::string& aud) {
    return why_claims(R"({"exp":1800000100,"eigencast":{})" + aud + "}");
  };
  for (const char* good : {R"(,"aud":"eigencast")", R"(,"aud":["x","eigencast"])"}) EXPECT_EQ(with(good), "accepted");
  for (const char* bad : {"", R"(,"aud":"Eigencast")", R"(,"aud":[])", R"(,"aud":["x"])", R"(,"aud":{"eigencast":1})",
                          R"(,"aud":[["eigencast"]])", R"(,"aud":7)"}) {
    EXPECT_THAT(with(bad), HasSubstr("\"aud\"")) << bad;
  }
  auto rules = rules_with({secret_key()});
  rules.issuer = "me";
  const auto issued = [&](const std::string& more) {
    return why(verify_token(signed_by(secret_key(), kHeader, claims_with(more)), rules, kNow));
  };
  EXPECT_EQ(issued(R"("iss":"me")"), "accepted");
  EXPECT_THAT(issued(R"("iss":"you")"), HasSubstr("\"iss\""));
  EXPECT_THAT(issued(""), HasSubstr("\"iss\""));
  EXPECT_THAT(issued(R"("iss":["me"])"), HasSubstr("\"iss\""));
}

TEST(JwtTest, DuplicateMembersAreRefusedAtEveryDepth) {
  EXPECT_THAT(why_claims(claims_with(R"("exp":1900000000)")), HasSubstr("claims"));
  EXPECT_THAT(why_claims(R"({"aud":"eigencast","exp":1800000100,"eigencast":{"admin":false,"admin":true}})"),
              HasSubstr("claims"));
  EXPECT_THAT(why_header(R"({"alg":"HS256","alg":"none","kid":"main"})"), HasSubstr("header"));
  // The same name in two different objects is not a duplicate.
  EXPECT_EQ(why_claims(claims_with(R"("x":{"exp":1},"y":{"exp":2})")), "accepted");
  EXPECT_THAT(why_claims(claims_with("\"x\":" + std::string(50, '[') + std::string(50, ']'))), HasSubstr("claims"));
}

TEST(JwtTest, TruncatedAndChangedTokensAreRefused) {
  for (const Golden& one : kGolden) {
    const auto rules = rules_with({TokenKey::from_pem("golden", one.algorithm, one.key).value()});
    const std::string token = one.token;
    for (std::size_t length = 0; length < token.size(); ++length) {
      EXPECT_FALSE(verify_token(token.substr(0, length), rules, kNow)) << length;
    }
    for (std::size_t at = 0; at < token.size(); ++at) {
      std::string changed = token;
      changed[at] = changed[at] == 'A' ? 'B' : 'A';
      EXPECT_FALSE(verify_token(changed, rules, kNow)) << at;
    }
    for (const char* more : {"=", ".", "A", " ", "\n"}) EXPECT_FALSE(verify_token(token + more, rules, kNow));
  }
  EXPECT_EQ(verify_token(std::string(kMaxTokenBytes + 1, 'a'), rules_with({}), kNow).error().code, ErrorCode::kRefused);
}

TEST(JwtTest, CreatedTokenGrantsWhatWasRequested) {
  const auto key = secret_key();
  const auto token = create_token({"camera 1", "eigencast", "me", {"lab/*"}, {"**"}, true, kNow, kNow + 60}, key);
  ASSERT_TRUE(token);
  EXPECT_THAT(why(verify_token(*token, rules_with({key}), kNow)), HasSubstr("\"sub\"")) << "blanks are refused";
  const auto good =
      create_token({"camera-1", "eigencast", "me", {"lab/*"}, {"**"}, true, kNow, kNow + 60, {"a"}, {"b", "c"}}, key)
          .value();
  const auto claims = verify_token(good, rules_with({key}), kNow);
  ASSERT_TRUE(claims) << claims.error().message;
  EXPECT_EQ(claims->key_id, "main");
  EXPECT_EQ(claims->expires_s, kNow + 60);
  EXPECT_THAT(claims->rights.publish.texts(), ElementsAre("lab/*"));
  EXPECT_THAT(claims->rights.speak.texts(), ElementsAre("a"));
  EXPECT_THAT(claims->rights.rewind.texts(), ElementsAre("b", "c"));
  EXPECT_TRUE(claims->rights.admin);
  EXPECT_FALSE(create_token({"x", "", "", {"a//b"}, {}, false, kNow, kNow + 60}, key));
  const auto public_half = TokenKey::from_pem("golden", Algorithm::kEs256, golden::kGoldenEs256Key).value();
  EXPECT_EQ(create_token({"x", "", "", {"a"}, {}, false, kNow, kNow + 60}, public_half).error().code,
            ErrorCode::kUnsupported);
}

TEST(JwtTest, KeysThatSignAreSecrets) {
  const std::string path = ::testing::TempDir() + "/eigencast_secret_" + std::to_string(::getpid());
  std::ofstream(path) << kSecret << "\n";
  chmod(path.c_str(), 0644);
  LoadedConfig loaded;
  loaded.config.access.jwt_keys = {"main HS256 " + path};
  EXPECT_THAT(exposed_secrets(loaded, ""), ElementsAre(HasSubstr(path)));
  const auto key = TokenKey::from_file("main", Algorithm::kHs256, path);
  ASSERT_TRUE(key) << key.error().message;
  EXPECT_TRUE(key->verifies("x", secret_key().sign("x").value())) << "the trailing newline is not part of the secret";
  std::ofstream(path) << golden::kGoldenEs256Key;
  chmod(path.c_str(), 0644);
  EXPECT_TRUE(TokenKey::from_file("a", Algorithm::kEs256, path));
  loaded.config.access.jwt_keys = {"main ES256 " + path};
  EXPECT_THAT(exposed_secrets(loaded, ""), ElementsAre()) << "a public key is for everybody";
  EXPECT_THAT(TokenKey::from_file("a", Algorithm::kRs256, path).error().message, HasSubstr(path));
  std::remove(path.c_str());
  EXPECT_EQ(TokenKey::from_file("a", Algorithm::kEs256, path).error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace eigencast::broker
