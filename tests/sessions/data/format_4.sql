BEGIN TRANSACTION;
CREATE TABLE accounts (
	id INTEGER NOT NULL, 
	name TEXT NOT NULL, 
	"key" VARCHAR(255) NOT NULL, 
	role VARCHAR(16) NOT NULL, 
	status VARCHAR(16) NOT NULL, 
	password TEXT, 
	created VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE ("key")
);
INSERT INTO "accounts" VALUES(1,'ann','ann','annotator','active','$argon2id$v=19$m=64,t=1,p=1$a7LSeEcOA7wsHpsaAzjYlw$8hNwghzRyjv4EaSCt2BYGNlyFHpKkiQiISEwHRsQ5+M','2026-11-27T17:09:36.092162Z');
INSERT INTO "accounts" VALUES(2,'rob','rob','annotator','unclaimed',NULL,'2026-11-27T17:09:36.092162Z');
INSERT INTO "accounts" VALUES(3,'boss','boss','manager','active','$argon2id$v=19$m=64,t=1,p=1$dAvmTQvoyvxDArEQoFuFOA$H8gnZPTolerhT24drXuEwOP34qSszj+3IAovcpDSNgw','2026-11-27T17:09:36.097968Z');
INSERT INTO "accounts" VALUES(4,'nora','nora','annotator','active',NULL,'2026-11-27T21:18:24.631486Z');
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0004');
CREATE TABLE assignments (
	object_id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	at VARCHAR(32) NOT NULL, 
	PRIMARY KEY (object_id), 
	FOREIGN KEY(object_id) REFERENCES objects (id), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
INSERT INTO "assignments" VALUES(2,1,'2026-11-27T17:09:36.124627Z');
CREATE TABLE audit (
	id INTEGER NOT NULL, 
	at VARCHAR(32) NOT NULL, 
	who TEXT NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	subject TEXT NOT NULL, 
	detail TEXT NOT NULL, 
	address TEXT NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO "audit" VALUES(1,'2026-11-27T17:09:36.103373Z','command line','account_added','boss','manager','');
INSERT INTO "audit" VALUES(2,'2026-11-27T17:09:36.108405Z','command line','account_added','ann','annotator','');
INSERT INTO "audit" VALUES(3,'2026-11-27T17:09:36.115411Z','command line','token_made','boss','nightly: read','');
INSERT INTO "audit" VALUES(4,'2026-11-27T17:09:36.125099Z','boss','assigned','object 2','ann','');
INSERT INTO "audit" VALUES(5,'2026-11-27T20:56:12.411118Z','boss','project_changed','project','name, instructions, labels, strict, required','');
INSERT INTO "audit" VALUES(6,'2026-11-27T21:18:24.637550Z','boss','invited','nora','annotator','');
INSERT INTO "audit" VALUES(7,'2026-11-27T21:18:24.649093Z','nora','claimed','nora','https://login.example.org','');
CREATE TABLE commands (
	object_id INTEGER NOT NULL, 
	seq INTEGER NOT NULL, 
	at VARCHAR(32) NOT NULL, 
	who TEXT NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	payload TEXT NOT NULL, 
	PRIMARY KEY (object_id, seq), 
	FOREIGN KEY(object_id) REFERENCES objects (id)
);
INSERT INTO "commands" VALUES(1,1,'2030-01-01T00:00:03.000000Z','ann','set_frame','{"kind":"set_frame","up_axis":"y","unit_scale":0.001}');
INSERT INTO "commands" VALUES(1,2,'2030-01-01T00:00:04.000000Z','ann','add_click','{"kind":"add_click","click":{"position":[0.1,0.2,0.3],"part":1,"positive":true,"element":7}}');
INSERT INTO "commands" VALUES(1,3,'2030-01-01T00:00:05.000000Z','ann','add_region','{"kind":"add_region","part":2,"elements":"abababababababababababababababababababababababababababababababab","positive":true,"count":12,"tool":"lasso"}');
INSERT INTO "commands" VALUES(1,4,'2030-01-01T00:00:06.000000Z','ann','add_click','{"kind":"add_click","click":{"position":[0,0,0],"part":2,"positive":false,"element":null}}');
INSERT INTO "commands" VALUES(1,5,'2030-01-01T00:00:07.000000Z','ann','remove_prompt','{"kind":"remove_prompt","index":2}');
INSERT INTO "commands" VALUES(1,6,'2030-01-01T00:00:08.000000Z','ann','add_part','{"kind":"add_part","part":3,"name":null}');
INSERT INTO "commands" VALUES(1,7,'2030-01-01T00:00:09.000000Z','ann','name_part','{"kind":"name_part","part":1,"name":"door"}');
INSERT INTO "commands" VALUES(1,8,'2030-01-01T00:00:10.000000Z','ann','delete_part','{"kind":"delete_part","part":3}');
INSERT INTO "commands" VALUES(1,9,'2030-01-01T00:00:11.000000Z','ann','set_category','{"kind":"set_category","category":"oven"}');
INSERT INTO "commands" VALUES(1,10,'2030-01-01T00:00:12.000000Z','ann','record_segmentation','{"kind":"record_segmentation","prompts_key":"56d5b0e3724a5e65f795eebc","labels":"abababababababababababababababababababababababababababababababab","segmenter":"walk","seconds":0.1,"counts":{"-1":1,"0":5,"1":6,"2":7}}');
INSERT INTO "commands" VALUES(1,11,'2030-01-01T00:00:13.000000Z','ann','record_prediction','{"kind":"record_prediction","prediction":{"tree":{"links":["link_0","link_1","link_2"],"joints":[{"name":"hinge","type":"revolute","parent":"link_0","child":"link_1","axis":[0.0,0.0,1.0],"origin":[0.5,0.0,0.0],"lower":0.0,"upper":1.5,"mimic":null},{"name":"spin","type":"continuous","parent":"link_0","child":"link_2","axis":[1.0,0.0,0.0],"origin":[0.0,0.0,0.0],"lower":null,"upper":null,"mimic":{"joint":"hinge","multiplier":2.0,"offset":0.1}}]},"problems":["small knob"],"confidence":{"link_1":0.9},"backend":"geometric 1","seed":3,"seconds":0.25,"raw_text":"","notes":{"link_1":"contact line"}},"segmentation":"abababababababababababababababababababababababababababababababab"}');
INSERT INTO "commands" VALUES(1,12,'2030-01-01T00:00:14.000000Z','rob','set_joint','{"kind":"set_joint","joint":{"name":"hinge","type":"revolute","parent":"link_0","child":"link_1","axis":[0.0,0.0,1.0],"origin":[0.5,0.0,0.0],"lower":0.0,"upper":1.0,"mimic":null}}');
INSERT INTO "commands" VALUES(1,13,'2030-01-01T00:00:15.000000Z','rob','set_root','{"kind":"set_root","link":"link_1"}');
INSERT INTO "commands" VALUES(1,14,'2030-01-01T00:00:16.000000Z','rob','set_root','{"kind":"set_root","link":"link_0"}');
INSERT INTO "commands" VALUES(1,15,'2030-01-01T00:00:17.000000Z','rob','undo','{"kind":"undo"}');
INSERT INTO "commands" VALUES(1,16,'2030-01-01T00:00:18.000000Z','rob','redo','{"kind":"redo"}');
INSERT INTO "commands" VALUES(1,17,'2030-01-01T00:00:20.000000Z','rob','lock_joint','{"kind":"lock_joint","child":"link_1","locked":true}');
INSERT INTO "commands" VALUES(1,18,'2030-01-01T00:00:21.000000Z','rob','reject','{"kind":"reject","reason":"axis","comment":"hangs left"}');
INSERT INTO "commands" VALUES(1,19,'2030-01-01T00:00:22.000000Z','rob','reopen','{"kind":"reopen","comment":"look again"}');
INSERT INTO "commands" VALUES(1,20,'2030-01-01T00:00:23.000000Z','rob','accept','{"kind":"accept","comment":"fine","note_problems":["touches at 0.2 rad"]}');
INSERT INTO "commands" VALUES(1,21,'2030-01-01T00:00:24.000000Z','rob','saved','{"kind":"saved","folder":"out/oven"}');
CREATE TABLE deliveries (
	id INTEGER NOT NULL, 
	webhook_id INTEGER NOT NULL, 
	event VARCHAR(32) NOT NULL, 
	payload TEXT NOT NULL, 
	attempts INTEGER NOT NULL, 
	due VARCHAR(32) NOT NULL, 
	problem TEXT NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(webhook_id) REFERENCES webhooks (id)
);
CREATE TABLE identities (
	issuer VARCHAR(255) NOT NULL, 
	subject VARCHAR(255) NOT NULL, 
	account_id INTEGER NOT NULL, 
	since VARCHAR(32) NOT NULL, 
	PRIMARY KEY (issuer, subject), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
INSERT INTO "identities" VALUES('https://login.example.org','7',4,'2026-11-27T21:18:24.648706Z');
CREATE TABLE invitations (
	hash VARCHAR(64) NOT NULL, 
	account_id INTEGER NOT NULL, 
	expires VARCHAR(32) NOT NULL, 
	PRIMARY KEY (hash), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
CREATE TABLE logins (
	state VARCHAR(64) NOT NULL, 
	browser VARCHAR(64) NOT NULL, 
	nonce VARCHAR(64) NOT NULL, 
	verifier VARCHAR(128) NOT NULL, 
	expires VARCHAR(32) NOT NULL, 
	PRIMARY KEY (state)
);
CREATE TABLE meta (
	"key" VARCHAR(64) NOT NULL, 
	value TEXT NOT NULL, 
	PRIMARY KEY ("key")
);
INSERT INTO "meta" VALUES('application','artiworld');
CREATE TABLE objects (
	id INTEGER NOT NULL, 
	path TEXT NOT NULL, 
	name TEXT NOT NULL, 
	sha256 VARCHAR(64), 
	created VARCHAR(32) NOT NULL, 
	assigned_to TEXT, 
	seq INTEGER NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	prompts INTEGER NOT NULL, 
	parts INTEGER NOT NULL, 
	category TEXT, 
	who TEXT, 
	updated VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (path)
);
INSERT INTO "objects" VALUES(1,'/scans/oven.ply','oven','eeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeee','2030-01-01T00:00:01.000000Z',NULL,21,'accepted',2,3,'oven','rob','2030-01-01T00:00:24.000000Z');
INSERT INTO "objects" VALUES(2,'/scans/laptop.glb','laptop',NULL,'2030-01-01T00:00:02.000000Z',NULL,0,'todo',0,1,NULL,'','2030-01-01T00:00:02.000000Z');
CREATE TABLE presence (
	object_id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	since VARCHAR(32) NOT NULL, 
	until VARCHAR(32) NOT NULL, 
	lease VARCHAR(32) NOT NULL, 
	PRIMARY KEY (object_id, account_id), 
	FOREIGN KEY(object_id) REFERENCES objects (id), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
CREATE TABLE project (
	id INTEGER NOT NULL, 
	settings TEXT NOT NULL, 
	who TEXT NOT NULL, 
	at VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO "project" VALUES(1,'{"name":"Kitchens","instructions":"# Doors\nAlways click the *front*.","labels":[{"category":"Oven","parts":["door","knob"]}],"strict":true,"required":["floating"],"formats":["urdf"],"collision":"","form":"folder","license":"","author":""}','boss','2026-11-27T20:56:12.410182Z');
CREATE TABLE snapshots (
	object_id INTEGER NOT NULL, 
	seq INTEGER NOT NULL, 
	format INTEGER NOT NULL, 
	blob BLOB NOT NULL, 
	PRIMARY KEY (object_id, seq), 
	FOREIGN KEY(object_id) REFERENCES objects (id)
);
INSERT INTO "snapshots" VALUES(1,8,1,X'7801A553DB6EA33014FC15CB2F7DF146069AA6E23BFAB4288A1C70B3D61A9CB54DBA51D47FDF3986C609E9DB069020E7CCCCB98C2FFCA47D306EE0752178D07F78FD2AF85185985E3AD78EBD1E62E07573F91417EEF5C9E80F5E4BC1C7E34EFD3588F033C7D760E22EB4CA6A045752824D0D838B2A3A8F14BC23497786A810B36AAF2DFEF75A75ECC3C45FECCCC6A360898125024E7A47EFFA639297A229B65BAACDA7EF5254F89A19CBCCA8BA8EB5D6B4BF05A354562C780AD13C2F78C43A3355F74C5685E0987B674539F3950BBE52342FC43757F29CF1833EA8684EFAAE9C6FE037E875467BDD3B60A7014C9AB973B1169BACF99251D47D6ABB5A405EEF219B0C19540F99342AF6D439E79F1EA1590BEEF8DA5DA7AD8E331472C839293B6AF24AF36514AC30C003300537C30ECD1CBC0E0156D89FAFAE50F01A2F65257FC802F79B9435DD155C44BF9FC8864D02797418AD15BC753D99122884C0B9B7BA27D52D6A68785A3E27EFB86062B27623578590AB120F99869A4D2E9C324EA82EFA516387204AC49BC494F24064BA64781AD454C243148E5E44BD3E90349591D4E0D0999D4E8CDAFFDF457DA7EE72EDAD1B6924F0298FCED1D94ADEA5BD34530D73274858D4FAFDC424A6959EEBC480CCAAEFCA86DB91D16A1EB4709A165AB733BD4E8D93ED50E9F6F31FE439720B');
INSERT INTO "snapshots" VALUES(1,16,1,X'7801ED56616FA33810FD2BC85FFA8546404AB3CDEFB84F1745C8C024F1C5600E4CB25594FF7E6F6C28245DADF6AEA7D5EE6ADB4635D8F366E6CD9B712EE2446DA74C2DD671283AFA1BFF9F43D1C8CE62B50C45698ABEA2DA7662BDB95CC38B68E9A4E82CD65128FA26939F1576C4ABC053AD6CD6155213361751043C59D7C64A6B5A1CC11A87A8540C853D2D73D278DF922C83B3B287E035E89B307008810310ECAF694DD538F751B889B75B0EAE75CF49B8C4D380984C88B22C8342ABE218067C3488EF70E270F3748713A61312921E6363242DBBCE046617C4C98097DCE125E1E699F186489E26FB9AF6D2AA13DD84F305F399753A59B75419D87A02BCCF29F3300D57934F946C1EB34B7B7967F2E9D6643599D4B2821B4755F0501AD33EBC379D7C7D9A0C4BD2640753EFAEA33DAB0559B3A45E4251484B7BD3BEA2D248662601EC8D218F6782073E32386F4167E1616268CDB6045DC510CE2840D403E2184F653BAFB25C7EE8772651381D039CDC386286582094A1E41CD65F46D5361B5F4CB6C541D67B0ADC76705058CF312096D104E9DC60CC145DC923055AD5C72C0EEC8182D6183B47816846140475833253F38412CD5050D893D43D71836F4672D1771D8A08C685AA332870DF52D7819C9C0BE95B59624288245A468F518CBF3FA268CD7F4BB43EFFFC89D3E8ED8E7550F75A430AA6626DC00A5BC0CC3555EC757BDD861BE13A5670C39B4EF9BA6FA2451C468B041FEE7456A81B1DFEC409D1D9B627E40E2007BC7248EE1C8054E9A614ABDB87F06E1765BBDB6D69CFCAE5309C37146140E731F7316DC99CF376D94DB117A6674A58CCD6181E886EE08877B1E2C05DAC5F662C025BEEF3C6182C27AF3BA9BB39655C9A77BE209A3B5F734EDF58C3E580A673D6377DCFECF9A99D1D8905933E97691ED172953CC9949ED3DDEA2525CA0BF0E15AEC7FE2760882F8BA394B7D047C4785A94BE0B394A040908D878B788C9D9222B146EF608D019A88F5EAEAA9789B2A2C04DFED17C1FD07DB8D5B6411C7EE3A725C24028CBBDEE353978141E15B1ED57D6DB89D30BD8CEED1594ECFBE1D1C0E031607A521DA09D85FAFE8035FD57811C18769D55EA1ABF03A9D155B9B3367CE67713337BC8E714054AA52C5D00048C71756740D20DEA2024956D5BDE9B9C751EBAFC595E0C81017E29905308B6BFE7A88CBCF802130FF304476F1AC21EF91ABAAD756355A710E09E76376BB8ED026A8224A74458CD3F8105D25B50E8EB5C9B9024865A74AAA0BB0ED8B96A1BED1E20556B92C8E5433C37B3215D95615F876C02A21BC84EA677249405D2BCF99A5CFC3C8C277199E921328FBB2B2B03C9A31D59D769C5A40F36FB57815FF006AE1DB65F8D280C28CF7DA70A7A3F0DF70ABC5FFF556FBA9E580C6FB058707CBE13B958567CBCD4CE7217F37D31FFFFD50FF5D971FF2AEFD45CBB2BDFE0304F41185');
CREATE TABLE tokens (
	id INTEGER NOT NULL, 
	hash VARCHAR(64) NOT NULL, 
	account_id INTEGER NOT NULL, 
	label TEXT NOT NULL, 
	scopes VARCHAR(80) NOT NULL, 
	created VARCHAR(32) NOT NULL, 
	expires VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id), 
	UNIQUE (hash), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
INSERT INTO "tokens" VALUES(1,'c961365d2a007df2c0f885092ae7f712a515af0e09c8c9e4b86691fe6154dfab',3,'nightly','read','2026-11-27T17:09:36.114593Z','2027-02-25T17:09:36.114624Z');
CREATE TABLE web_sessions (
	hash VARCHAR(64) NOT NULL, 
	account_id INTEGER NOT NULL, 
	created VARCHAR(32) NOT NULL, 
	expires VARCHAR(32) NOT NULL, 
	PRIMARY KEY (hash), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
CREATE TABLE webhooks (
	id INTEGER NOT NULL, 
	account_id INTEGER NOT NULL, 
	url TEXT NOT NULL, 
	secret TEXT NOT NULL, 
	events TEXT NOT NULL, 
	created VARCHAR(32) NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(account_id) REFERENCES accounts (id)
);
CREATE TRIGGER commands_no_update BEFORE UPDATE ON commands BEGIN SELECT RAISE(ABORT, 'commands are only ever appended'); END;
CREATE TRIGGER commands_no_delete BEFORE DELETE ON commands BEGIN SELECT RAISE(ABORT, 'commands are only ever appended'); END;
CREATE INDEX ix_web_sessions_account_id ON web_sessions (account_id);
CREATE INDEX ix_tokens_account_id ON tokens (account_id);
CREATE INDEX audit_at ON audit (at);
CREATE INDEX ix_deliveries_due ON deliveries (due);
CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'audit is append-only'); END;
CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'audit is append-only'); END;
CREATE INDEX ix_identities_account_id ON identities (account_id);
COMMIT;
